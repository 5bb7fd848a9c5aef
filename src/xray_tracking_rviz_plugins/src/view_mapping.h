#pragma once

#include <algorithm>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Where an image is seen in a widget: widget = offset + scale * (pixel + 0.5). Pixel coordinates are whole at pixel
/// centres, widget coordinates at the edges of the screen's pixels.
struct ViewMapping
{
  static constexpr double kMinScale = 0.02;
  static constexpr double kMaxScale = 64.0;

  double scale = 1.0;
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();  ///< of the image's upper left corner

  Eigen::Vector2d toWidget(const Eigen::Vector2d& pixel) const
  {
    return offset + scale * (pixel + Eigen::Vector2d(0.5, 0.5));
  }
  Eigen::Vector2d toPixel(const Eigen::Vector2d& widget) const
  {
    return (widget - offset) / scale - Eigen::Vector2d(0.5, 0.5);
  }

  /// All of the image in the middle of the widget.
  static ViewMapping fit(const cv::Size& image, const cv::Size& widget)
  {
    ViewMapping mapping;
    mapping.scale = std::clamp(std::min(static_cast<double>(widget.width) / std::max(image.width, 1),
                                        static_cast<double>(widget.height) / std::max(image.height, 1)),
                               kMinScale, kMaxScale);
    mapping.offset = { 0.5 * (widget.width - mapping.scale * image.width),
                       0.5 * (widget.height - mapping.scale * image.height) };
    return mapping;
  }

  /// Larger by a factor, with the image staying in place at a point of the widget.
  ViewMapping zoomed(double factor, const Eigen::Vector2d& at) const
  {
    ViewMapping mapping;
    mapping.scale = std::clamp(scale * factor, kMinScale, kMaxScale);
    mapping.offset = at - mapping.scale / scale * (at - offset);
    return mapping;
  }

  ViewMapping moved(const Eigen::Vector2d& by) const { return { scale, offset + by }; }

  bool operator==(const ViewMapping& other) const { return scale == other.scale && offset == other.offset; }
};
}  // namespace xray_tracking
