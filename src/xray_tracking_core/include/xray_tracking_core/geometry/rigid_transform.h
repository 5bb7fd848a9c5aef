#pragma once

#include <Eigen/Geometry>

namespace xray_tracking
{
/// A rigid transform; translations in mm. Named target_from_source: `p_room = room_from_patient * p_patient`.
using RigidTransform = Eigen::Isometry3d;

/// (rotation vector [rad], translation [mm]), in this order.
using Twist = Eigen::Matrix<double, 6, 1>;

/// Builds a transform from a translation [mm] and a quaternion, which is normalised.
/// @throws std::invalid_argument if a component is not finite or the quaternion's norm is off 1 by more than 1e-3.
RigidTransform makeRigidTransform(const Eigen::Vector3d& translation, const Eigen::Quaterniond& rotation);

/// Rotation vector [rad] to rotation matrix (Rodrigues), exact at zero.
Eigen::Matrix3d rotationFromVector(const Eigen::Vector3d& rotation_vector);

/// Rotation matrix to rotation vector [rad], norm in [0, pi].
Eigen::Vector3d vectorFromRotation(const Eigen::Matrix3d& rotation);

/// The transform that rotates by `twist.head<3>()` about `centre` (a point of the frame in which the motion is
/// expressed, mm) and then translates by `twist.tail<3>()`.
RigidTransform motionAbout(const Eigen::Vector3d& centre, const Twist& twist);

/// Inverse of motionAbout.
Twist twistAbout(const Eigen::Vector3d& centre, const RigidTransform& motion);

/// Angle [rad] of a transform's rotation, in [0, pi].
double rotationAngle(const RigidTransform& transform);

/// Skew-symmetric matrix of v: skew(v) * w = v x w.
Eigen::Matrix3d skew(const Eigen::Vector3d& v);

/// True if every entry is finite and the linear part is a proper rotation to 1e-6.
bool isRigid(const RigidTransform& transform);
}  // namespace xray_tracking
