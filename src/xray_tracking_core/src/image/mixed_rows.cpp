#include "xray_tracking_core/image/mixed_rows.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include <Eigen/Core>

#include "xray_tracking_core/several_processors.h"

// How vectors would be passed to functions that are not inlined: none is, but by its place.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace xray_tracking
{
namespace
{
constexpr int kLeastSize = 48;  // of a part [px]
/// Of products of what alternates, three to six rows apart: with signs that change from one to the next they take out
/// what changes evenly over these distances, as anatomy does.
constexpr int kFirstLag = 3;
constexpr int kLastLag = 6;
constexpr double kRounding = 1.0;  // of whole numbers that are the same all along rows, and of compressed ones; squared
constexpr int kBlock = 16;         // edge of the blocks whose scatter tells how sure a sum is [px]
/// Found on thorax_01 and knee_real: as they are 0.3 px at most, woven with the exposure before 2 to 18. Fields so far
/// apart move what is measured by half of it.
constexpr double kLeastApart = 1.5;
constexpr double kSure = 4.0;         // standard deviations
constexpr double kOfMedian = 1.4826;  // a standard deviation, of absolute values

/// As many columns as are looked at together: sums of a row in single precision, in registers.
constexpr int kLanes = 16;
using Lanes = float __attribute__((vector_size(kLanes * sizeof(float))));

inline __attribute__((always_inline)) Lanes load(const float* from)
{
  Lanes lanes;
  __builtin_memcpy(&lanes, from, sizeof(lanes));
  return lanes;
}

double sumOf(const Lanes& lanes)
{
  double sum = 0.0;
  for (int lane = 0; lane < kLanes; ++lane)
  {
    sum += static_cast<double>(lanes[lane]);
  }
  return sum;
}

/// Sums over a part of a row: of values, of what they may be like, of products and of squares of that.
struct LikeSums
{
  Lanes values = {}, like = {}, products = {}, squares = {};
};

/// What alternates, of one sign in every other row. Of the row's last columns less than kLanes are in no sum.
FOR_SEVERAL_PROCESSORS void alternate(const float* above, const float* row, const float* below, float sign, int count,
                                      float* to, LikeSums* sums)
{
  for (int x = 0; x < count; ++x)
  {
    to[x] = sign * (row[x] - 0.5f * (above[x] + below[x]));
  }
  LikeSums of_row;
  for (int x = 0; x + kLanes <= count; x += kLanes)
  {
    const Lanes value = load(to + x);
    const Lanes like = load(row + x);
    of_row.values += value;
    of_row.like += like;
    of_row.products += value * like;
    of_row.squares += like * like;
  }
  *sums = of_row;
}

FOR_SEVERAL_PROCESSORS void takeOut(const float* like, float gain, float offset, int count, float* values)
{
  for (int x = 0; x < count; ++x)
  {
    values[x] -= gain * like[x] + offset;
  }
}

FOR_SEVERAL_PROCESSORS void addProducts(const float* row, std::ptrdiff_t stride, int count, float* products)
{
  const float* third = row + kFirstLag * stride;
  const float* fourth = third + stride;
  const float* fifth = fourth + stride;
  const float* sixth = fifth + stride;
  static_assert(kLastLag == kFirstLag + 3, "the signs are those of four rows");
  for (int x = 0; x < count; ++x)
  {
    products[x] += row[x] * (0.125f * (third[x] + sixth[x]) + 0.375f * (fourth[x] + fifth[x]));
  }
}

FOR_SEVERAL_PROCESSORS void sumSlopes(const float* row, std::ptrdiff_t stride, int count, Lanes* across, Lanes* along)
{
  const float* third = row + 3 * stride;
  const float* above = row - 2 * stride;
  const float* below = row + 2 * stride;
  Lanes across_sum = {}, along_sum = {};
  for (int x = 0; x + kLanes <= count; x += kLanes)
  {
    across_sum += (load(row + x + 2) - load(row + x)) * (load(third + x + 2) - load(third + x));
    along_sum += (load(below + x + 1) - load(above + x + 1)) * (load(below + x + 4) - load(above + x + 4));
  }
  *across = across_sum;
  *along = along_sum;
}

/// Mean squares of an image's slopes [1/px^2], the larger one of both directions, without white noise: by products of
/// slopes some pixels apart, which see the same structure.
double slopes(const cv::Mat& values)
{
  double across = 0.0, along = 0.0;
  const int count = (values.cols - 5) / kLanes * kLanes;
  for (int y = 2; y + 5 < values.rows; ++y)
  {
    Lanes across_sum, along_sum;
    sumSlopes(values.ptr<float>(y), static_cast<std::ptrdiff_t>(values.step1()), count, &across_sum, &along_sum);
    across += sumOf(across_sum);
    along += sumOf(along_sum);
  }
  return std::max({ across / 4.0, along / 16.0, 1e-9 }) / (static_cast<double>(values.rows - 7) * count);
}

/// The gain and the constant by which values are like others.
class GainAndOffset
{
public:
  void add(const LikeSums& of_row, int count)
  {
    sum_ += sumOf(of_row.values), like_ += sumOf(of_row.like);
    product_ += sumOf(of_row.products), square_ += sumOf(of_row.squares);
    count_ += count / kLanes * kLanes;
  }
  double gain() const
  {
    const double variance = square_ - like_ * like_ / count_;
    return variance > 0.0 ? (product_ - sum_ * like_ / count_) / variance : 0.0;
  }
  double offset() const { return (sum_ - gain() * like_) / count_; }

private:
  double sum_ = 0.0, like_ = 0.0, product_ = 0.0, square_ = 0.0, count_ = 0.0;
};
}  // namespace

double MixedRows::woven(const cv::Mat& image, const cv::Rect& part)
{
  image(part).convertTo(values_, CV_32F);
  const int columns = part.width, rows = part.height - 2;
  alternating_.create(rows, columns, CV_32FC1);
  GainAndOffset every_other;
  for (int y = 0; y < rows; ++y)
  {
    LikeSums sums;
    alternate(values_.ptr<float>(y), values_.ptr<float>(y + 1), values_.ptr<float>(y + 2), y % 2 == 0 ? 1.f : -1.f,
              columns, alternating_.ptr<float>(y), &sums);
    every_other.add(sums, columns);
  }
  const auto gain = static_cast<float>(every_other.gain());
  const auto offset = static_cast<float>(every_other.offset());
  for (int y = 0; y < rows; ++y)
  {
    takeOut(values_.ptr<float>(y + 1), gain, offset, columns, alternating_.ptr<float>(y));
  }
  sums_.clear();
  products_.resize(columns);
  for (int first = 0; first + kBlock + kLastLag <= rows; first += kBlock)
  {
    products_.setZero();
    for (int y = first; y < first + kBlock; ++y)
    {
      addProducts(alternating_.ptr<float>(y), columns, columns, products_.data());
    }
    for (int x = 0; x + kBlock <= columns; x += kBlock)
    {
      sums_.push_back(static_cast<double>(products_.segment<kBlock>(x).sum()) / (kBlock * kBlock));
    }
  }
  const double mean = std::accumulate(sums_.begin(), sums_.end(), 0.0) / static_cast<double>(sums_.size());
  // Structure is in some blocks, noise in all.
  std::transform(sums_.begin(), sums_.end(), sums_.begin(), [](double sum) { return std::abs(sum); });
  const auto middle = sums_.begin() + static_cast<std::ptrdiff_t>(sums_.size() / 2);
  std::nth_element(sums_.begin(), middle, sums_.end());
  const double deviation = kOfMedian * *middle / std::sqrt(static_cast<double>(sums_.size()));
  const double apart = std::sqrt(std::max(0.0, mean) / slopes(values_));
  const double least = image.depth() == CV_32F ? 0.0 : kRounding;
  return mean > std::max(least, kSure * deviation) && apart > kLeastApart ? apart : 0.0;
}

const std::string& MixedRows::look(const cv::Mat& image, const cv::Rect& part)
{
  fault_.clear();
  const cv::Rect seen = part & cv::Rect(cv::Point(), image.size());
  if (seen.width < kLeastSize || seen.height < kLeastSize)
  {
    return fault_;
  }
  if (const double apart = woven(image, seen); apart > 0.0)
  {
    fault_ =
        "every other row is of another exposure: they are about " + std::to_string(std::lround(apart)) + " px apart";
  }
  return fault_;
}
}  // namespace xray_tracking
