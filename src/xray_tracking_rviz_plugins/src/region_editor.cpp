#include "region_editor.h"

#include <algorithm>
#include <cmath>

namespace xray_tracking
{
namespace
{
using Grip = RegionEditor::Grip;

bool holdsLeft(Grip grip)
{
  return grip == Grip::LEFT || grip == Grip::TOP_LEFT || grip == Grip::BOTTOM_LEFT;
}
bool holdsRight(Grip grip)
{
  return grip == Grip::RIGHT || grip == Grip::TOP_RIGHT || grip == Grip::BOTTOM_RIGHT;
}
bool holdsTop(Grip grip)
{
  return grip == Grip::TOP || grip == Grip::TOP_LEFT || grip == Grip::TOP_RIGHT;
}
bool holdsBottom(Grip grip)
{
  return grip == Grip::BOTTOM || grip == Grip::BOTTOM_LEFT || grip == Grip::BOTTOM_RIGHT;
}

/// The edge between two pixels that is nearest to a position.
int edgeAt(double pixel, int size)
{
  return std::clamp(static_cast<int>(std::lround(pixel + 0.5)), 0, size);
}
}  // namespace

void RegionEditor::setImageSize(const cv::Size& size)
{
  if (size == image_size_)
  {
    return;
  }
  image_size_ = size;
  grip_ = Grip::NONE;
  if (region_)
  {
    set(*region_);
  }
}

std::optional<cv::Rect> RegionEditor::set(const cv::Rect& region)
{
  const cv::Rect inside = region & cv::Rect(cv::Point(), image_size_);
  region_ = inside.width >= kMinSize && inside.height >= kMinSize ? std::optional<cv::Rect>(inside) : std::nullopt;
  return region_;
}

void RegionEditor::clear()
{
  region_.reset();
  grip_ = Grip::NONE;
}

Grip RegionEditor::gripAt(const Eigen::Vector2d& pixel, double reach) const
{
  if (!region_)
  {
    return Grip::NONE;
  }
  const double left = region_->x - 0.5, top = region_->y - 0.5;
  const double right = left + region_->width, bottom = top + region_->height;
  const double x = pixel.x(), y = pixel.y();
  if (x < left - reach || x > right + reach || y < top - reach || y > bottom + reach)
  {
    return Grip::NONE;
  }
  // The nearer one, where a region is so small that a pointer reaches both.
  const bool at_left = std::abs(x - left) <= reach && std::abs(x - left) <= std::abs(x - right);
  const bool at_right = !at_left && std::abs(x - right) <= reach;
  const bool at_top = std::abs(y - top) <= reach && std::abs(y - top) <= std::abs(y - bottom);
  const bool at_bottom = !at_top && std::abs(y - bottom) <= reach;
  if (at_top)
  {
    return at_left ? Grip::TOP_LEFT : at_right ? Grip::TOP_RIGHT : Grip::TOP;
  }
  if (at_bottom)
  {
    return at_left ? Grip::BOTTOM_LEFT : at_right ? Grip::BOTTOM_RIGHT : Grip::BOTTOM;
  }
  return at_left ? Grip::LEFT : at_right ? Grip::RIGHT : Grip::INSIDE;
}

void RegionEditor::press(const Eigen::Vector2d& pixel, double reach)
{
  before_ = region_;
  pressed_ = pixel;
  grip_ = gripAt(pixel, reach);
  drawing_ = grip_ == Grip::NONE;
  if (drawing_)
  {
    grip_ = Grip::BOTTOM_RIGHT;
  }
}

bool RegionEditor::drag(const Eigen::Vector2d& pixel)
{
  if (grip_ == Grip::NONE || !pixel.allFinite())
  {
    return false;
  }
  const std::optional<cv::Rect> last = region_;
  if (drawing_)
  {
    const int x0 = edgeAt(pressed_.x(), image_size_.width), x1 = edgeAt(pixel.x(), image_size_.width);
    const int y0 = edgeAt(pressed_.y(), image_size_.height), y1 = edgeAt(pixel.y(), image_size_.height);
    const cv::Rect drawn(cv::Point(std::min(x0, x1), std::min(y0, y1)), cv::Point(std::max(x0, x1), std::max(y0, y1)));
    region_ = drawn.width >= kMinSize && drawn.height >= kMinSize ? std::optional<cv::Rect>(drawn) : before_;
  }
  else if (grip_ == Grip::INSIDE)
  {
    const Eigen::Vector2d by = pixel - pressed_;
    region_->x = std::clamp(static_cast<int>(std::lround(before_->x + by.x())), 0, image_size_.width - region_->width);
    region_->y =
        std::clamp(static_cast<int>(std::lround(before_->y + by.y())), 0, image_size_.height - region_->height);
  }
  else
  {
    int left = before_->x, top = before_->y, right = left + before_->width, bottom = top + before_->height;
    if (holdsLeft(grip_))
    {
      left = std::min(edgeAt(pixel.x(), image_size_.width), right - kMinSize);
    }
    if (holdsRight(grip_))
    {
      right = std::max(edgeAt(pixel.x(), image_size_.width), left + kMinSize);
    }
    if (holdsTop(grip_))
    {
      top = std::min(edgeAt(pixel.y(), image_size_.height), bottom - kMinSize);
    }
    if (holdsBottom(grip_))
    {
      bottom = std::max(edgeAt(pixel.y(), image_size_.height), top + kMinSize);
    }
    region_ = cv::Rect(cv::Point(left, top), cv::Point(right, bottom));
  }
  return region_ != last;
}

void RegionEditor::release()
{
  grip_ = Grip::NONE;
}
}  // namespace xray_tracking
