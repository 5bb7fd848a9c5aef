#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <tf2_ros/buffer.h>

#include "xray_tracking_motion_estimation/camera_info_watch.h"

namespace xray_tracking
{
/// The detectors' geometry, by their camera_infos and by tf: one is accepted, and everything that differs from it later
/// is a fault.
class GeometryWatch
{
public:
  /// @param detectors names; @param tf_buffer outlives this
  GeometryWatch(const std::vector<std::string>& detectors, const tf2_ros::Buffer& tf_buffer);

  void update(std::size_t detector, const sensor_msgs::CameraInfo& info);

  /// Once an exposure. @return what is missing, or has changed; empty if nothing has
  std::string check();
  /// What is wrong with a detector's latest camera_info; empty if nothing is.
  const std::string& fault(std::size_t detector) const { return views_[detector].camera_info.fault(); }
  /// Once check() has found nothing wrong. One a detector. @throws std::invalid_argument if it is none
  std::vector<ProjectionGeometry> geometries() const;
  /// That is the one: from here on tf must not say anything else.
  void accept() { accepted_ = true; }

private:
  struct View
  {
    std::string name;
    CameraInfoWatch camera_info;
    RigidTransform room_from_optical;  ///< the accepted one, or the latest
  };
  /// @throws tf2's exceptions
  std::string check(View& view) const;

  const tf2_ros::Buffer& tf_buffer_;
  std::vector<View> views_;
  bool accepted_ = false;
};
}  // namespace xray_tracking
