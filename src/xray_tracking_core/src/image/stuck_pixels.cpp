#include "stuck_pixels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <opencv2/imgproc.hpp>

#include "pixel_type.h"
#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
namespace
{
// A stuck pixel is apart from its surroundings by so many standard deviations of the image's noise, and by so many
// widths of the ring around it; of normal noise that width is a standard deviation.
constexpr float kApart = 6.f;
constexpr float kWidths = 3.f;
/// Of the ring's 16 pixels, those that agree best: the others may be stuck, too.
constexpr std::size_t kAgreeing = 8;
// What is next to a stuck pixel and not stuck deviates by less than this part of it, or than so many standard
// deviations of the noise; what a blur has passed ends more softly.
constexpr float kContinues = 0.3f;
constexpr float kByNoise = 4.f;
constexpr float kOfMedian = 1.4826f;
constexpr float kElectronic = 0.5f;  // of the dark half's variance, at least
constexpr float kLeastNoise = 0.5f;  // of whole numbers
constexpr int kEvery = 5;            // pixels that the noise is estimated from

/// What the ring of 16 pixels around one agrees about.
struct Ring
{
  float centre;
  float width;
};

template <typename Pixel>
Ring ringAround(const cv::Mat& image, int x, int y)
{
  std::array<float, 16> values;
  std::size_t n = 0;
  for (int dy = -2; dy <= 2; ++dy)
  {
    const Pixel* row = image.ptr<Pixel>(std::clamp(y + dy, 0, image.rows - 1));
    for (int dx = -2; dx <= 2; dx += std::abs(dy) == 2 ? 1 : 4)
    {
      values[n++] = static_cast<float>(row[std::clamp(x + dx, 0, image.cols - 1)]);
    }
  }
  std::sort(values.begin(), values.end());
  std::size_t first = 0;
  for (std::size_t i = 1; i + kAgreeing <= values.size(); ++i)
  {
    first = values[i + kAgreeing - 1] - values[i] < values[first + kAgreeing - 1] - values[first] ? i : first;
  }
  return { values[first + kAgreeing / 2], values[first + kAgreeing - 1] - values[first] };
}

/// A pixel's level and how far it is from the median around it.
using Sample = StuckPixels::Sample;

/// Variance as a linear function of the level: electronic noise and quanta.
class NoiseModel
{
public:
  /// @param least standard deviation
  NoiseModel(std::vector<Sample>& samples, float least) : least_(least * least)
  {
    if (samples.size() < 2)
    {
      return;
    }
    const auto by_level = [](const Sample& a, const Sample& b) { return a.level < b.level; };
    const auto by_deviation = [](const Sample& a, const Sample& b) { return a.deviation < b.deviation; };
    const auto middle_of = [](auto first, auto last, const auto& less)
    {
      const auto middle = first + (last - first) / 2;
      std::nth_element(first, middle, last, less);
      return *middle;
    };
    const auto squared = [](float deviation) { return kOfMedian * kOfMedian * deviation * deviation; };
    const auto middle = samples.begin() + static_cast<std::ptrdiff_t>(samples.size() / 2);
    std::nth_element(samples.begin(), middle, samples.end(), by_level);
    dark_ = middle_of(samples.begin(), middle, by_level).level;
    const float bright = middle_of(middle, samples.end(), by_level).level;
    at_dark_ = squared(middle_of(samples.begin(), middle, by_deviation).deviation);
    const float at_bright = squared(middle_of(middle, samples.end(), by_deviation).deviation);
    slope_ = bright > dark_ ? std::max(0.f, (at_bright - at_dark_) / (bright - dark_)) : 0.f;
    least_ = std::max(least_, kElectronic * at_dark_);
  }
  float variance(float level) const { return std::max(least_, at_dark_ + slope_ * (level - dark_)); }

private:
  float least_, dark_ = 0.f, at_dark_ = 0.f, slope_ = 0.f;
};
}  // namespace

template <typename Pixel>
void StuckPixels::find(const cv::Mat& image, const cv::Mat& flaws, const cv::Rect& part)
{
  samples_.clear();
  candidates_.clear();
  for (int y = 0; y < part.height; y += 2)
  {
    const Pixel* values = image.ptr<Pixel>(part.y + y) + part.x;
    const Pixel* smooth = smooth_.ptr<Pixel>(y);
    const std::uint8_t* f = flaws.ptr(y);
    for (int x = y / 2 % kEvery; x < part.width; x += kEvery)
    {
      const float deviation = std::abs(static_cast<float>(values[x]) - static_cast<float>(smooth[x]));
      if (f[x] == 0 && deviation > 0.f)
      {
        samples_.push_back({ static_cast<float>(smooth[x]), deviation });
      }
    }
  }
  const NoiseModel noise(samples_, image.depth() == CV_32F ? 0.f : kLeastNoise);

  for (int y = 0; y < part.height; ++y)
  {
    const Pixel* values = image.ptr<Pixel>(part.y + y) + part.x;
    const Pixel* smooth = smooth_.ptr<Pixel>(y);
    const std::uint8_t* f = flaws.ptr(y);
    for (int x = 0; x < part.width; ++x)
    {
      const float deviation = static_cast<float>(values[x]) - static_cast<float>(smooth[x]);
      if (deviation * deviation > kApart * kApart * noise.variance(static_cast<float>(smooth[x])) &&
          (f[x] & BORDER) == 0)
      {
        const Ring ring = ringAround<Pixel>(image, part.x + x, part.y + y);
        const float apart = std::abs(static_cast<float>(values[x]) - ring.centre);
        const float sd = std::sqrt(noise.variance(ring.centre));
        if (apart > kApart * sd && apart > kWidths * ring.width)
        {
          candidates_.push_back({ { x, y }, ring.centre, kByNoise * sd });
        }
      }
    }
  }
}

void StuckPixels::mark(const cv::Mat& image, const cv::Rect& part, cv::Mat& flaws)
{
  cv::medianBlur(image(part), smooth_, 5);
  withPixelType(image, [&](auto pixel) { find<decltype(pixel)>(image, flaws, part); });
  for (const Candidate& candidate : candidates_)
  {
    flaws.at<std::uint8_t>(candidate.place) |= STUCK;
  }
  withPixelType(
      image,
      [&](auto pixel)
      {
        using Pixel = decltype(pixel);
        const auto continues = [&](const Candidate& candidate)
        {
          const cv::Point p = candidate.place;
          const float apart = static_cast<float>(image.at<Pixel>(p + part.tl())) - candidate.centre;
          for (int y = std::max(0, p.y - 1); y <= std::min(part.height - 1, p.y + 1); ++y)
          {
            for (int x = std::max(0, p.x - 1); x <= std::min(part.width - 1, p.x + 1); ++x)
            {
              const float other = static_cast<float>(image.at<Pixel>(y + part.y, x + part.x)) - candidate.centre;
              if ((flaws.at<std::uint8_t>(y, x) & STUCK) == 0 && other / apart > kContinues)
              {
                return true;
              }
            }
          }
          return false;
        };
        candidates_.erase(std::stable_partition(candidates_.begin(), candidates_.end(), continues), candidates_.end());
      });
  for (const Candidate& candidate : candidates_)
  {
    flaws.at<std::uint8_t>(candidate.place) &= static_cast<std::uint8_t>(~STUCK);
  }
}
}  // namespace xray_tracking
