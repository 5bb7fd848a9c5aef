#pragma once

#include <exception>
#include <optional>

#include <geometry_msgs/Pose.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
/// A pose to be shown; none if the message's numbers are none.
inline std::optional<RigidTransform> rigidOf(const geometry_msgs::Pose& pose)
{
  try
  {
    return rigidFromPoseMsg(pose);
  }
  catch (const std::exception&)
  {
    return std::nullopt;
  }
}
}  // namespace xray_tracking
