#include "image_bins.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numeric>

#include <opencv2/imgproc.hpp>

#include "pixel_type.h"

namespace xray_tracking
{
namespace
{
constexpr int kLeastEdge = 3;
constexpr double kBrightest = 0.95;
constexpr int kEvery = 5;  // bins that quantiles are taken of
/// The quieter quartile of the ranges of three values, as others may have structure in them; and what that is of
/// normally distributed values, in standard deviations.
constexpr double kQuieter = 0.25;
constexpr float kRangeOfThree = 1.024f;
constexpr float kLit = 0.01f;  // of the brightest: what has quantum noise
/// Attenuation beyond this is not in line integrals, but in units of which nothing is known.
constexpr double kLargestAttenuation = 16.0;
constexpr double kUsualLargest = 8.0;

float quantile(std::vector<float>& values, double share)
{
  if (values.empty())
  {
    return 0.f;
  }
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}
}  // namespace

template <typename Pixel>
void ImageBins::fill(const cv::Mat& image)
{
  // On a diagonal, so that a dead row or column is no more than one of three.
  const auto place = [this](int bin, int sample, int count)
  { return std::min(bin * edge_ + (2 * sample + 1) * edge_ / 6, count - 1); };
  columns_.resize(3 * static_cast<std::size_t>(values_.cols));
  for (std::size_t i = 0; i < columns_.size(); ++i)
  {
    columns_[i] = place(static_cast<int>(i / 3), static_cast<int>(i % 3), image.cols);
  }
  int number = 0;
  for (int y = 0; y < values_.rows; ++y)
  {
    float* values = values_.ptr<float>(y);
    const std::array<const Pixel*, 3> rows{ image.ptr<Pixel>(place(y, 0, image.rows)),
                                            image.ptr<Pixel>(place(y, 1, image.rows)),
                                            image.ptr<Pixel>(place(y, 2, image.rows)) };
    for (int x = 0; x < values_.cols; ++x)
    {
      const int* columns = &columns_[3 * static_cast<std::size_t>(x)];
      const auto a = static_cast<float>(rows[0][columns[0]]);
      const auto b = static_cast<float>(rows[1][columns[1]]);
      const auto c = static_cast<float>(rows[2][columns[2]]);
      const float low = std::min(a, b), high = std::max(a, b);
      values[x] = std::max(low, std::min(high, c));
      if (++number % kEvery == 0)
      {
        samples_.push_back({ values[x], std::max(high, c) - std::min(low, c) });
      }
    }
  }
}

void ImageBins::update(const cv::Mat& image, const IntensityModel& intensity)
{
  edge_ = std::max(kLeastEdge, (std::max(image.cols, image.rows) + bins_ - 1) / bins_);
  values_.create((image.rows + edge_ - 1) / edge_, (image.cols + edge_ - 1) / edge_, CV_32FC1);
  samples_.clear();
  withPixelType(image, [&](auto pixel) { fill<decltype(pixel)>(image); });
  cv::minMaxLoc(values_, &smallest_, &largest_);

  const bool counts = intensity.kind == IntensityModel::Kind::COUNTS;
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
  sorted_.clear();
  const float* light = light_.ptr<float>();
  for (std::size_t i = 0; i < light_.total(); i += kEvery)
  {
    sorted_.push_back(light[i]);
  }
  brightest_ = quantile(sorted_, kBrightest);
  step_ = counts && image.depth() != CV_32F ? 1.f : 0.f;
  noise_ = quantum_ = 0.f;
  if (counts)
  {
    measureNoise(intensity.offset);
  }
}

void ImageBins::measureNoise(double offset)
{
  sorted_.clear();
  for (const Sample& sample : samples_)
  {
    sorted_.push_back(sample.range / kRangeOfThree);
  }
  noise_ = quantile(sorted_, kQuieter);
  sorted_.clear();
  for (const Sample& sample : samples_)
  {
    const float light = sample.value - static_cast<float>(offset);
    if (light > kLit * brightest_)
    {
      sorted_.push_back(std::pow(sample.range / kRangeOfThree, 2.f) / light);
    }
  }
  quantum_ = quantile(sorted_, kQuieter);
}

double ImageBins::correlation() const
{
  // Without what stuck pixels make of bins that they reach: many times the rest's light.
  const auto clipped = [this](float light) { return static_cast<double>(std::min(light, brightest_)); };
  double sum = 0.0;
  for (int y = 0; y < light_.rows; ++y)
  {
    const float* row = light_.ptr<float>(y);
    sum += std::accumulate(row, row + light_.cols, 0.0, [&](double s, float light) { return s + clipped(light); });
  }
  const double mean = sum / static_cast<double>(light_.total());
  double squares = 0.0, along_rows = 0.0, along_columns = 0.0;
  for (int y = 0; y + 1 < light_.rows; ++y)
  {
    const float* row = light_.ptr<float>(y);
    const float* next = light_.ptr<float>(y + 1);
    for (int x = 0; x + 1 < light_.cols; ++x)
    {
      const double v = clipped(row[x]) - mean;
      squares += v * v;
      along_rows += v * (clipped(row[x + 1]) - mean);
      along_columns += v * (clipped(next[x]) - mean);
    }
  }
  return squares > 0.0 ? std::min(along_rows, along_columns) / squares : 0.0;
}
}  // namespace xray_tracking
