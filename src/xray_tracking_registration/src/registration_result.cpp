#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
Eigen::Matrix<double, 6, 6> RegistrationResult::poseCovariance(const Eigen::Vector3d& target_centre) const
{
  if (!covariance.allFinite())
  {
    return Eigen::Matrix<double, 6, 6>::Zero();
  }
  Eigen::Matrix<double, 6, 6> pose_from_twist = Eigen::Matrix<double, 6, 6>::Zero();
  // The origin moves by translation + rotation x lever.
  const Eigen::Vector3d lever = -(room_from_patient.linear() * target_centre);
  pose_from_twist.topLeftCorner<3, 3>() = -skew(lever);
  pose_from_twist.topRightCorner<3, 3>().setIdentity();
  pose_from_twist.bottomLeftCorner<3, 3>().setIdentity();
  return pose_from_twist * covariance * pose_from_twist.transpose();
}
}  // namespace xray_tracking
