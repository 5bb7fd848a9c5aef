#pragma once

#include <optional>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// A rectangle of pixels that is drawn, moved and resized with a pointer. Always inside the image, and at least
/// kMinSize pixels each way.
class RegionEditor
{
public:
  static constexpr int kMinSize = 8;

  enum class Grip
  {
    NONE,
    INSIDE,
    LEFT,
    RIGHT,
    TOP,
    BOTTOM,
    TOP_LEFT,
    TOP_RIGHT,
    BOTTOM_LEFT,
    BOTTOM_RIGHT
  };

  /// Of the image; a region that is outside of it goes.
  void setImageSize(const cv::Size& size);
  const std::optional<cv::Rect>& region() const { return region_; }
  /// @return what of it is inside the image; none if that is too small
  std::optional<cv::Rect> set(const cv::Rect& region);
  void clear();

  /// What a pointer there would take hold of. @param reach of edges and corners [px]
  Grip gripAt(const Eigen::Vector2d& pixel, double reach) const;

  /// The pointer goes down: takes hold of the region, or begins another one.
  void press(const Eigen::Vector2d& pixel, double reach);
  /// The pointer moves while it is down. @return whether the region changed
  bool drag(const Eigen::Vector2d& pixel);
  /// The pointer goes up; what is too small to be meant leaves the region as it was.
  void release();
  bool dragging() const { return grip_ != Grip::NONE; }

private:
  cv::Size image_size_;
  std::optional<cv::Rect> region_;
  std::optional<cv::Rect> before_;  ///< the region when the pointer went down
  Grip grip_ = Grip::NONE;
  bool drawing_ = false;
  Eigen::Vector2d pressed_ = Eigen::Vector2d::Zero();
};
}  // namespace xray_tracking
