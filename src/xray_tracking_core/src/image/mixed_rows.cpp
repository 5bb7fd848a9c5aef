#include "xray_tracking_core/image/mixed_rows.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include <Eigen/Core>

#include "pixel_type.h"

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
constexpr int kNarrow = 4;            // columns that become one where a seam is looked for: most noise goes
constexpr int kMostNarrow = 48;       // of those
/// 400; an edge that lies between two rows all along them has 7 behind a detector's blur of 0.65 px.
constexpr float kLeastRatio = 8.f;
/// A seam goes through all columns, a thing with an edge may be in two of these next to each other.
constexpr int kBands = 4;
constexpr float kLeastOfBand = 3.f;
constexpr double kLeastTorn = 1.5;  // [px], as kLeastApart

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
  slopes_ = slopes(values_);
  const double apart = std::sqrt(std::max(0.0, mean) / slopes_);
  const double least = image.depth() == CV_32F ? 0.0 : kRounding;
  return mean > std::max(least, kSure * deviation) && apart > kLeastApart ? apart : 0.0;
}

int MixedRows::torn(const cv::Mat& image, const cv::Rect& field)
{
  const int every = std::max(kNarrow, field.width / kMostNarrow);
  values_.create(field.height, (field.width - kNarrow) / every + 1, CV_32FC1);
  withPixelType(image,
                [&](auto pixel)
                {
                  for (int y = 0; y < values_.rows; ++y)
                  {
                    const auto* from = image.ptr<decltype(pixel)>(field.y + y) + field.x;
                    float* to = values_.ptr<float>(y);
                    for (int x = 0; x < values_.cols; ++x, from += every)
                    {
                      to[x] = (static_cast<float>(from[0]) + static_cast<float>(from[1]) + static_cast<float>(from[2]) +
                               static_cast<float>(from[3])) /
                              kNarrow;
                    }
                  }
                });
  const int count = values_.cols;
  energies_.resize(values_.rows - 1, kBands);
  for (int y = 0; y + 1 < values_.rows; ++y)
  {
    for (int band = 0; band < kBands; ++band)
    {
      const int number = count / kBands, first = band * number;
      const auto before = rowOf(values_, y, first, number), behind = rowOf(values_, y + 1, first, number);
      step_ = behind - before;
      middle_ = 0.5f * (behind + before);
      // Of a band: a thing in front of another one would make a step in all.
      GainAndOffset of_half;
      of_half.add(step_, middle_);
      of_half.removeFrom(step_, middle_);
      energies_(y, band) = step_.square().sum() / static_cast<float>(number);
    }
  }
  all_ = energies_.rowwise().mean();
  const float rounding = image.depth() == CV_32F ? 0.f : static_cast<float>(kRounding);
  const auto usual_of = [this, rounding](const auto& energies)
  {
    sorted_ = energies;
    float* middle = sorted_.data() + sorted_.size() / 2;
    std::nth_element(sorted_.data(), middle, sorted_.data() + sorted_.size());
    return std::max(rounding, *middle);
  };
  const auto beside = [](const auto& energies, Eigen::Index y, float usual) {
    return std::max({ energies[y - 1], energies[y + 1], usual });
  };
  const float usual = usual_of(all_);
  const float least = static_cast<float>(kLeastTorn * kLeastTorn * slopes_);
  for (Eigen::Index y = 1; y + 1 < all_.size(); ++y)
  {
    const float around = beside(all_, y, usual);
    if (all_[y] > kLeastRatio * around && all_[y] - around > least)
    {
      int first = kBands, last = -1;
      for (int band = 0; band < kBands; ++band)
      {
        const auto of_band = energies_.col(band);
        if (of_band[y] > kLeastOfBand * beside(of_band, y, usual_of(of_band)))
        {
          first = std::min(first, band);
          last = band;
        }
      }
      if (last - first > 1)
      {
        return field.y + static_cast<int>(y) + 1;
      }
    }
  }
  return -1;
}

const std::string& MixedRows::look(const cv::Mat& image, const cv::Rect& part, const XrayField& field)
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
    return fault_;
  }
  const cv::Rect wide(seen.x - seen.width / 2, 0, 2 * seen.width, image.rows);
  const cv::Rect inside = field.inside(wide & cv::Rect(cv::Point(), image.size()));
  if (inside.width < kLeastSize || inside.height < kLeastSize)
  {
    return fault_;
  }
  if (const int row = torn(image, inside); row >= 0)
  {
    fault_ = "the rows from " + std::to_string(row) + " on are of another exposure than those before";
  }
  return fault_;
}
}  // namespace xray_tracking
