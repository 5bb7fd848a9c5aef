#include "image_bins.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <numeric>

#include <Eigen/Core>
#include <opencv2/imgproc.hpp>

#include "pixel_type.h"

namespace xray_tracking
{
namespace
{
constexpr int kLeastEdge = 3;
constexpr double kBrightest = 0.95;
constexpr int kSamples = 400;  // bins that quantiles are taken of, at least, if there are as many
/// The quieter quartile of the ranges of three values, as others may have structure in them; and what that is of
/// normally distributed values, in standard deviations.
constexpr double kQuieter = 0.25;
constexpr float kRangeOfThree = 1.024f;
constexpr float kOfQuartile = 1.8f;  // standard deviation of its square, times the root of the number, as a share of it
constexpr float kLit = 0.01f;        // of the brightest: what has quantum noise
/// Attenuation beyond this is not in line integrals, but in units of which nothing is known.
constexpr double kLargestAttenuation = 16.0;
constexpr double kUsualLargest = 8.0;

float squared(float x)
{
  return x * x;
}

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
  const auto rows_of = [&](int y)
  {
    return std::array<const Pixel*, 3>{ image.ptr<Pixel>(place(y, 0, image.rows)),
                                        image.ptr<Pixel>(place(y, 1, image.rows)),
                                        image.ptr<Pixel>(place(y, 2, image.rows)) };
  };
  const int whole = std::min(image.cols / edge_, values_.cols);  // the last bin may be a part of one
  for (int y = 0; y < values_.rows; ++y)
  {
    const std::array<const Pixel*, 3> rows = rows_of(y);
    const Pixel* first = rows[0] + place(0, 0, image.cols);
    const Pixel* second = rows[1] + place(0, 1, image.cols);
    const Pixel* third = rows[2] + place(0, 2, image.cols);
    float* values = values_.ptr<float>(y);
    for (int x = 0; x < whole; ++x)
    {
      const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(x) * edge_;
      values[x] = Sample(first[at], second[at], third[at]).value;
    }
    for (int x = whole; x < values_.cols; ++x)
    {
      values[x] =
          Sample(rows[0][place(x, 0, image.cols)], rows[1][place(x, 1, image.cols)], rows[2][place(x, 2, image.cols)])
              .value;
    }
  }
  samples_.clear();
  for (int i = 0; i < static_cast<int>(values_.total()); i += every_)
  {
    const int x = i % values_.cols;
    const std::array<const Pixel*, 3> rows = rows_of(i / values_.cols);
    samples_.emplace_back(rows[0][place(x, 0, image.cols)], rows[1][place(x, 1, image.cols)],
                          rows[2][place(x, 2, image.cols)]);
  }
}

void ImageBins::update(const cv::Mat& image, const IntensityModel& intensity)
{
  edge_ = std::max(kLeastEdge, (std::max(image.cols, image.rows) + bins_ - 1) / bins_);
  values_.create((image.rows + edge_ - 1) / edge_, (image.cols + edge_ - 1) / edge_, CV_32FC1);
  // So many that they are not of the same columns in every row.
  every_ = std::max(1, static_cast<int>(values_.total()) / kSamples);
  while (std::gcd(every_, values_.cols) != 1)
  {
    ++every_;
  }
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
  for (std::size_t i = 0; i < light_.total(); i += static_cast<std::size_t>(every_))
  {
    sorted_.push_back(light[i]);
  }
  brightest_ = quantile(sorted_, kBrightest);
  step_ = counts && image.depth() != CV_32F ? 1.f : 0.f;
  noise_ = quantum_ = growth_ = growth_error_ = 0.f;
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
      sorted_.push_back(squared(sample.range / kRangeOfThree) / light);
    }
  }
  quantum_ = quantile(sorted_, kQuieter);

  const auto middle = samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() / 2);
  std::nth_element(samples_.begin(), middle, samples_.end(),
                   [](const Sample& a, const Sample& b) { return a.value < b.value; });
  const auto of_half = [this](auto first, auto last, auto figure, double share)
  {
    sorted_.clear();
    std::transform(first, last, std::back_inserter(sorted_), figure);
    return quantile(sorted_, share);
  };
  const auto value = [](const Sample& sample) { return sample.value; };
  const auto range = [](const Sample& sample) { return sample.range / kRangeOfThree; };
  const float apart = of_half(middle, samples_.end(), value, 0.5) - of_half(samples_.begin(), middle, value, 0.5);
  const float bright = of_half(middle, samples_.end(), range, kQuieter);
  const float dark = of_half(samples_.begin(), middle, range, kQuieter);
  growth_ = apart > 0.f ? (squared(bright) - squared(dark)) / apart : 0.f;
  growth_error_ = apart > 0.f ? kOfQuartile * std::hypot(squared(bright), squared(dark)) /
                                    (apart * std::sqrt(0.5f * static_cast<float>(samples_.size())))
                              : 0.f;
}

double ImageBins::correlation() const
{
  // Without what stuck pixels make of bins that they reach: many times the rest's light. Sums of a row in single
  // precision, which vectors are made of.
  using Row = Eigen::Map<const Eigen::ArrayXf>;
  const auto row = [this](int y, int first)
  { return Row(light_.ptr<float>(y) + first, light_.cols - 1).min(brightest_); };
  double sum = 0.0;
  for (int y = 0; y < light_.rows; ++y)
  {
    sum += static_cast<double>(Row(light_.ptr<float>(y), light_.cols).min(brightest_).sum());
  }
  const float mean = static_cast<float>(sum / static_cast<double>(light_.total()));
  double squares = 0.0, along_rows = 0.0, along_columns = 0.0;
  for (int y = 0; y + 1 < light_.rows; ++y)
  {
    const auto values = row(y, 0) - mean;
    squares += static_cast<double>(values.square().sum());
    along_rows += static_cast<double>((values * (row(y, 1) - mean)).sum());
    along_columns += static_cast<double>((values * (row(y + 1, 0) - mean)).sum());
  }
  return squares > 0.0 ? std::min(along_rows, along_columns) / squares : 0.0;
}
}  // namespace xray_tracking
