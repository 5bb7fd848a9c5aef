#pragma once

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// Of (translation of a point [mm], rotation vector about the fixed room axes [rad]). The point of a published pose is
/// the patient frame's origin.
using PoseCovariance = Matrix6d;

/// From (translation of the origin, rotation vector) to (translation of a point, rotation vector). With the point at p
/// = t + R c, dp = dt - (R c) x d. The inverse has -`arm`.
/// @param arm R c: from the origin to the point, room axes [mm]
inline PoseCovariance pointFromOriginJacobian(const Eigen::Vector3d& arm)
{
  PoseCovariance jacobian = PoseCovariance::Identity();
  jacobian.topRightCorner<3, 3>() = -skew(arm);
  return jacobian;
}

/// A pose's covariance with the point's translation in the place of the origin's. @param point patient frame [mm]
inline PoseCovariance covarianceAt(const Eigen::Vector3d& point, const RigidTransform& room_from_patient,
                                   const PoseCovariance& covariance)
{
  const PoseCovariance jacobian = pointFromOriginJacobian(room_from_patient.linear() * point);
  return jacobian * covariance * jacobian.transpose();
}
}  // namespace xray_tracking
