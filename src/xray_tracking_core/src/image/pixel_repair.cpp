#include "xray_tracking_core/image/pixel_repair.h"

#include <algorithm>
#include <cstddef>

#include "pixel_type.h"

namespace xray_tracking
{
namespace
{
constexpr int kFarthest = 24;  // of a neighbour, across a line of letters [px]
constexpr int kLeastNeighbours = 4;
}  // namespace

void PixelRepair::clear()
{
  stuck_.release();
  repairs_.clear();
}

void PixelRepair::add(const ImageReport& report, const cv::Size& size)
{
  if (stuck_.size() != size)
  {
    clear();
  }
  if (report.stuck == 0.0)
  {
    return;
  }
  if (stuck_.empty())
  {
    stuck_ = cv::Mat::zeros(size, CV_8UC1);
  }
  cv::Mat part = stuck_(report.part);
  cv::bitwise_or(part, report.flaws & STUCK, part);

  repairs_.clear();
  for (int y = 0; y < size.height; ++y)
  {
    for (int x = 0; x < size.width; ++x)
    {
      if (stuck_.at<std::uint8_t>(y, x) == 0)
      {
        continue;
      }
      Repair repair;
      repair.place = { x, y };
      const auto add_neighbour = [&](int column, int row)
      {
        if (repair.count < kNeighbours && column >= 0 && row >= 0 && column < size.width && row < size.height &&
            stuck_.at<std::uint8_t>(row, column) == 0)
        {
          repair.neighbours[static_cast<std::size_t>(repair.count++)] = { column, row };
        }
      };
      for (int reach = 1; reach <= kFarthest && repair.count < kLeastNeighbours; ++reach)
      {
        // Opposite ones after each other, lest a full list lean to one side.
        for (int along = -reach; along < reach; ++along)
        {
          add_neighbour(x + along, y - reach), add_neighbour(x - along, y + reach);
          add_neighbour(x + reach, y + along), add_neighbour(x - reach, y - along);
        }
      }
      if (repair.count > 0)
      {
        repairs_.push_back(repair);
      }
    }
  }
}

void PixelRepair::apply(const cv::Mat& image, cv::Mat& repaired) const
{
  image.copyTo(repaired);
  // The places of the repairs are those of an image of this size.
  if (image.size() != stuck_.size() || !isPixelType(image))
  {
    return;
  }
  withPixelType(image,
                [&](auto pixel)
                {
                  using Pixel = decltype(pixel);
                  std::array<Pixel, kNeighbours> values;
                  for (const Repair& repair : repairs_)
                  {
                    const auto end = values.begin() + repair.count;
                    std::transform(repair.neighbours.begin(), repair.neighbours.begin() + repair.count, values.begin(),
                                   [&image](const cv::Point& p) { return image.at<Pixel>(p); });
                    const auto middle = values.begin() + repair.count / 2;
                    std::nth_element(values.begin(), middle, end);
                    repaired.at<Pixel>(repair.place) = *middle;
                  }
                });
}
}  // namespace xray_tracking
