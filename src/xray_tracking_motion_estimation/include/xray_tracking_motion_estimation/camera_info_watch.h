#pragma once

#include <optional>
#include <string>

#include <sensor_msgs/CameraInfo.h>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
/// A detector's camera_info: the first valid one counts, any that differs from it later is a fault.
class CameraInfoWatch
{
public:
  void update(const std::string& detector, const sensor_msgs::CameraInfo& info);

  bool valid() const { return accepted_.has_value(); }
  /// The frame that a valid camera_info is given in.
  const std::string& frame() const { return accepted_->header.frame_id; }
  /// What is wrong with the latest camera_info; empty if nothing is.
  const std::string& fault() const { return fault_; }

  /// Of a valid camera_info. The panel's distance is nominal, as a camera_info does not have it: neither projections
  /// nor pitch * c of eqs. (2), (3) depend on it. @throws std::invalid_argument if the pose is none
  ProjectionGeometry geometry(const std::string& detector, const RigidTransform& room_from_optical) const;

private:
  std::optional<sensor_msgs::CameraInfo> accepted_;
  std::string fault_;
};
}  // namespace xray_tracking
