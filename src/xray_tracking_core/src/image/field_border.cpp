#include "field_border.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
/// Lead lets less than a hundredth through; what is seen behind it is scatter: close to the edge a half of that in the
/// field, where scatter may be a half of all.
constexpr float kRise = 0.3f;
// Before it there is little: towards its edge a round body grows thinner as a root, a blade does not.
constexpr float kRiseBefore = 0.12f;
constexpr int kFlat = 4;  // bins
// Least rise, as ratios of what is hardly above the offset say nothing: of the brightest bins, in steps of whole
// numbers, and in standard deviations of a pixel's quantum noise behind it.
constexpr float kLeastOfBrightest = 0.003f;
constexpr float kLeastSteps = 4.f;
constexpr float kLeastOfNoise = 2.f;
constexpr int kThin = 7;  // bins: what protrudes into the field and is thinner is no border

const cv::Mat& square(int edge)
{
  static const cv::Mat kThree = cv::getStructuringElement(cv::MORPH_RECT, { 3, 3 });
  static const cv::Mat kWide = cv::getStructuringElement(cv::MORPH_RECT, { kThin, kThin });
  return edge == 3 ? kThree : kWide;
}

/// Of a rise, and of its square a count behind it.
struct Least
{
  float rise;
  float squared;
};

/// Marks what a ray from the image's border passes before the field, if it is dark up to a steep rise. @return whether
bool markRay(const float* light, std::uint8_t* marks, std::ptrdiff_t stride, int count, const Least& least)
{
  float largest = light[0];
  int last = -1;
  for (int i = 1; i + 2 < count; ++i)
  {
    const float behind = std::min(light[(i + 1) * stride], light[(i + 2) * stride]);
    const float before = light[(i - 1) * stride] - light[std::max(0, i - kFlat) * stride];
    const float rise = behind - largest;
    if (largest < kRise * behind && rise > least.rise && rise * rise > least.squared * behind &&
        before < kRiseBefore * behind)
    {
      last = i;
    }
    largest = std::max(largest, light[i * stride]);
  }
  for (int i = 0; i <= last; ++i)
  {
    marks[i * stride] = 255;
  }
  return last >= 0;
}
}  // namespace

void FieldBorder::close(const ImageBins& bins)
{
  outside_.create(bins.light().size(), CV_8UC1);
  outside_.setTo(255);
  any_ = true;
}

void FieldBorder::update(const ImageBins& bins)
{
  // Without what is bright and small: letters beside the field.
  cv::morphologyEx(bins.light(), opened_, cv::MORPH_OPEN, square(3));
  const int rows = opened_.rows, columns = opened_.cols;
  const Least least{ std::max(kLeastOfBrightest * bins.brightest(), kLeastSteps * bins.step()),
                     kLeastOfNoise * kLeastOfNoise * bins.quantum() };
  outside_.create(opened_.size(), CV_8UC1);
  outside_.setTo(0);
  any_ = false;
  // Most rays begin so bright that no rise is steep.
  using Image = Eigen::Map<const Eigen::Array<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
  const Image all(opened_.ptr<float>(), rows, columns);
  largest_of_row_ = all.rowwise().maxCoeff();
  largest_of_column_ = all.colwise().maxCoeff();
  const auto mark = [this, &least](int x, int y, std::ptrdiff_t stride, int count, float largest)
  {
    const float* light = opened_.ptr<float>(y) + x;
    any_ |= *light < kRise * largest && markRay(light, outside_.ptr(y) + x, stride, count, least);
  };
  const std::ptrdiff_t stride = columns;  // of both: neither is a part of another image
  for (int y = 0; y < rows; ++y)
  {
    mark(0, y, 1, columns, largest_of_row_[y]);
    mark(columns - 1, y, -1, columns, largest_of_row_[y]);
  }
  for (int x = 0; x < columns; ++x)
  {
    mark(x, 0, stride, rows, largest_of_column_[x]);
    mark(x, rows - 1, -stride, rows, largest_of_column_[x]);
  }
  if (!any_)
  {
    return;
  }
  leaveBrightestPart();
  // A frame around the image counts as outside, so that what is thin along the image's border stays.
  framed_.create(rows + 2 * kThin, columns + 2 * kThin, CV_8UC1);
  framed_.setTo(255);
  cv::Mat inner = framed_({ kThin, kThin, columns, rows });
  outside_.copyTo(inner);
  cv::morphologyEx(framed_, framed_, cv::MORPH_CLOSE, square(kThin));  // notches, where anatomy is as dark as blades
  cv::morphologyEx(framed_, framed_, cv::MORPH_OPEN, square(kThin));
  cv::dilate(inner, outside_, square(3), { -1, -1 }, 1, cv::BORDER_CONSTANT | cv::BORDER_ISOLATED);
}

/// Of the parts that the marks separate, all but the one with the most light are outside, too: the corners between
/// blades, which no ray leaves.
void FieldBorder::leaveBrightestPart()
{
  outside_.copyTo(visited_);
  double most = -1.0;
  field_.clear();
  for (int y = 0; y < visited_.rows; ++y)
  {
    for (int x = 0; x < visited_.cols; ++x)
    {
      if (visited_.at<std::uint8_t>(y, x) != 0)
      {
        continue;
      }
      double light = 0.0;
      part_.clear();
      const auto visit = [this](int column, int row)
      {
        if (column >= 0 && row >= 0 && column < visited_.cols && row < visited_.rows &&
            visited_.at<std::uint8_t>(row, column) == 0)
        {
          visited_.at<std::uint8_t>(row, column) = 255;
          part_.emplace_back(column, row);
        }
      };
      visit(x, y);
      for (std::size_t i = 0; i < part_.size(); ++i)
      {
        const cv::Point p = part_[i];
        light += opened_.at<float>(p);
        visit(p.x + 1, p.y), visit(p.x - 1, p.y), visit(p.x, p.y + 1), visit(p.x, p.y - 1);
      }
      if (light > most)
      {
        most = light;
        std::swap(part_, field_);
      }
    }
  }
  outside_.setTo(255);
  for (const cv::Point& p : field_)
  {
    outside_.at<std::uint8_t>(p) = 0;
  }
}

}  // namespace xray_tracking
