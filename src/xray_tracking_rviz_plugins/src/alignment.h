#pragma once

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// A patient's pose that is moved by hand: shifted along the room's axes, and turned about axes parallel to them
/// through the target's centre, so that a turn shifts no target.
class Alignment
{
public:
  /// @param room_from_patient where it starts; @param target_centre patient frame [mm]
  Alignment(const RigidTransform& room_from_patient, const Eigen::Vector3d& target_centre);

  void shiftBy(const Eigen::Vector3d& shift);  ///< room axes [mm]
  void turnBy(const Eigen::Vector3d& turn);    ///< rotation vector, room axes [rad]
  /// Sets where the target's centre is in the room [mm] and how it is turned since the start. What is no such thing
  /// changes nothing.
  void place(const Eigen::Vector3d& target, const Eigen::Quaterniond& turn);

  /// room_from_patient
  RigidTransform pose() const;
  Eigen::Vector3d target() const { return start_ * target_centre_ + shift_; }  ///< its centre, room [mm]

  // Since the start.
  const Eigen::Vector3d& shift() const { return shift_; }   ///< of the target's centre, room axes [mm]
  const Eigen::Quaterniond& turn() const { return turn_; }  ///< room axes
  Eigen::Vector3d turnVector() const;                       ///< rotation vector, room axes [rad]

private:
  RigidTransform start_;
  Eigen::Vector3d target_centre_;
  Eigen::Vector3d shift_ = Eigen::Vector3d::Zero();
  Eigen::Quaterniond turn_ = Eigen::Quaterniond::Identity();
};
}  // namespace xray_tracking
