#include "alignment.h"

#include <cmath>

namespace xray_tracking
{
Alignment::Alignment(const RigidTransform& room_from_patient, const Eigen::Vector3d& target_centre)
  : start_(room_from_patient), target_centre_(target_centre)
{
}

void Alignment::shiftBy(const Eigen::Vector3d& shift)
{
  place(target() + shift, turn_);
}

void Alignment::turnBy(const Eigen::Vector3d& turn)
{
  place(target(), Eigen::Quaterniond(rotationFromVector(turn)) * turn_);
}

void Alignment::place(const Eigen::Vector3d& target, const Eigen::Quaterniond& turn)
{
  const double norm = turn.norm();
  if (target.allFinite() && std::abs(norm - 1.0) < 1e-3)
  {
    shift_ = target - start_ * target_centre_;
    turn_ = turn.normalized();
  }
}

RigidTransform Alignment::pose() const
{
  RigidTransform pose;
  pose.linear() = turn_.toRotationMatrix() * start_.linear();
  pose.translation() = target() - pose.linear() * target_centre_;
  return pose;
}

Eigen::Vector3d Alignment::turnVector() const
{
  return vectorFromRotation(turn_.toRotationMatrix());
}
}  // namespace xray_tracking
