#include "xray_tracking_core/image/mixed_rows.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include <Eigen/Core>

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

using Row = Eigen::Map<const Eigen::ArrayXf>;

/// A part of a row of an image of floats.
Row rowOf(const cv::Mat& values, int y, int first, int count)
{
  return Row(values.ptr<float>(y) + first, count);
}

Eigen::Map<Eigen::ArrayXf> rowOf(cv::Mat& values, int y)
{
  return Eigen::Map<Eigen::ArrayXf>(values.ptr<float>(y), values.cols);
}

/// Mean squares of an image's slopes [1/px^2], the larger one of both directions, without white noise: by products of
/// slopes some pixels apart, which see the same structure.
double slopes(const cv::Mat& values)
{
  double across = 0.0, along = 0.0;
  const int count = values.cols - 5;
  for (int y = 2; y + 5 < values.rows; ++y)
  {
    const auto at = [&values, y, count](int row, int column) { return rowOf(values, y + row, column, count); };
    across += static_cast<double>(((at(0, 2) - at(0, 0)) * (at(3, 2) - at(3, 0))).sum());
    along += static_cast<double>(((at(2, 1) - at(-2, 1)) * (at(2, 4) - at(-2, 4))).sum());
  }
  return std::max({ across / 4.0, along / 16.0, 1e-9 }) / (static_cast<double>(values.rows - 7) * count);
}

/// Takes out of values what is like others and a constant. Sums of a row in single precision, for vectors.
class GainAndOffset
{
public:
  template <typename Values, typename Like>
  void add(const Values& values, const Like& like)
  {
    sum_ += static_cast<double>(values.sum()), like_ += static_cast<double>(like.sum());
    product_ += static_cast<double>((values * like).sum()), square_ += static_cast<double>(like.square().sum());
    count_ += static_cast<double>(values.size());
  }
  template <typename Values, typename Like>
  void removeFrom(Values& values, const Like& like) const
  {
    const double variance = square_ - like_ * like_ / count_;
    const double gain = variance > 0.0 ? (product_ - sum_ * like_ / count_) / variance : 0.0;
    values -= static_cast<float>(gain) * like + static_cast<float>((sum_ - gain * like_) / count_);
  }

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
    const auto at = [this, y, columns](int row) { return rowOf(values_, y + row, 0, columns); };
    auto alternating = rowOf(alternating_, y);
    alternating = (y % 2 == 0 ? 1.f : -1.f) * (at(1) - 0.5f * (at(0) + at(2)));
    every_other.add(alternating, at(1));
  }
  for (int y = 0; y < rows; ++y)
  {
    auto alternating = rowOf(alternating_, y);
    every_other.removeFrom(alternating, rowOf(values_, y + 1, 0, columns));
  }
  sums_.clear();
  products_.resize(columns);
  for (int first = 0; first + kBlock + kLastLag <= rows; first += kBlock)
  {
    products_.setZero();
    for (int y = first; y < first + kBlock; ++y)
    {
      const auto at = [this, y, columns](int lag) { return rowOf(alternating_, y + lag, 0, columns); };
      products_ += at(0) * (0.125f * (at(kFirstLag) + at(kLastLag)) + 0.375f * (at(kFirstLag + 1) + at(kFirstLag + 2)));
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
