#include "image_bins.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include <opencv2/imgproc.hpp>

#include "pixel_type.h"

namespace xray_tracking
{
namespace
{
constexpr int kBins = 128;  // along the longer side
constexpr int kLeastEdge = 3;
constexpr double kBrightest = 0.95;
/// Mean range of nine normally distributed values, in standard deviations.
constexpr float kRangeOfNine = 2.97f;
/// Attenuation beyond this is not in line integrals, but in units of which nothing is known. [1]
constexpr double kLargestAttenuation = 16.0;
constexpr double kUsualLargest = 8.0;

struct MedianAndRange
{
  float median;
  float range;
};

MedianAndRange ofNine(std::array<float, 9>& v)
{
  const auto order = [&v](std::size_t a, std::size_t b)
  {
    const float low = std::min(v[a], v[b]);
    v[b] = std::max(v[a], v[b]);
    v[a] = low;
  };
  // Rows, then columns of the 3 x 3 array, then the diagonal; the extremes are in the corners before the diagonal.
  order(0, 1), order(1, 2), order(0, 1), order(3, 4), order(4, 5), order(3, 4), order(6, 7), order(7, 8), order(6, 7);
  order(0, 3), order(3, 6), order(0, 3), order(1, 4), order(4, 7), order(1, 4), order(2, 5), order(5, 8), order(2, 5);
  const float range = v[8] - v[0];
  order(2, 4), order(4, 6), order(2, 4);
  return { v[4], range };
}

float quantile(std::vector<float>& values, double share)
{
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}
}  // namespace

template <typename Pixel>
void ImageBins::fill(const cv::Mat& image)
{
  const auto place = [this](int bin, int sample, int count)
  { return std::min(bin * edge_ + (2 * sample + 1) * edge_ / 6, count - 1); };
  std::array<float, 9> v;
  for (int y = 0; y < values_.rows; ++y)
  {
    float* values = values_.ptr<float>(y);
    const std::array<const Pixel*, 3> rows{ image.ptr<Pixel>(place(y, 0, image.rows)),
                                            image.ptr<Pixel>(place(y, 1, image.rows)),
                                            image.ptr<Pixel>(place(y, 2, image.rows)) };
    for (int x = 0; x < values_.cols; ++x)
    {
      for (int i = 0; i < 3; ++i)
      {
        const int column = place(x, i, image.cols);
        for (std::size_t j = 0; j < 3; ++j)
        {
          v[3 * j + static_cast<std::size_t>(i)] = static_cast<float>(rows[j][column]);
        }
      }
      const MedianAndRange nine = ofNine(v);
      values[x] = nine.median;
      spreads_.push_back(nine.range);
    }
  }
}

void ImageBins::update(const cv::Mat& image, const IntensityModel& intensity)
{
  edge_ = std::max(kLeastEdge, (std::max(image.cols, image.rows) + kBins - 1) / kBins);
  values_.create((image.rows + edge_ - 1) / edge_, (image.cols + edge_ - 1) / edge_, CV_32FC1);
  spreads_.clear();
  withPixelType(image, [&](auto pixel) { fill<decltype(pixel)>(image); });
  cv::minMaxLoc(values_, &smallest_, &largest_);

  const bool counts = intensity.kind == IntensityModel::Kind::COUNTS;
  step_ = counts && image.depth() != CV_32F ? 1.f : 0.f;
  noise_ = counts ? quantile(spreads_, 0.5) / kRangeOfNine : 0.f;
  if (counts)
  {
    cv::subtract(values_, intensity.offset, light_);
    cv::max(light_, 0.0, light_);
  }
  else
  {
    const double scale = largest_ > kLargestAttenuation ? kUsualLargest / largest_ : 1.0;
    values_.convertTo(light_, CV_32F, -scale);
    cv::exp(light_, light_);
  }
  sorted_.assign(light_.begin<float>(), light_.end<float>());
  brightest_ = quantile(sorted_, kBrightest);
}

double ImageBins::correlation() const
{
  double squares = 0.0, products = 0.0;
  const double mean = cv::mean(light_)[0];
  for (int y = 0; y + 1 < light_.rows; ++y)
  {
    const float* row = light_.ptr<float>(y);
    const float* next = light_.ptr<float>(y + 1);
    for (int x = 0; x + 1 < light_.cols; ++x)
    {
      const double v = row[x] - mean;
      squares += v * v;
      products += 0.5 * v * (row[x + 1] + next[x] - 2.0 * mean);
    }
  }
  return squares > 0.0 ? products / squares : 0.0;
}
}  // namespace xray_tracking
