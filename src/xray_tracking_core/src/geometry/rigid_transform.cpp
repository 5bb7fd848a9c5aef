#include "xray_tracking_core/geometry/rigid_transform.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

namespace xray_tracking
{
RigidTransform makeRigidTransform(const Eigen::Vector3d& translation, const Eigen::Quaterniond& rotation)
{
  if (!translation.allFinite())
  {
    std::ostringstream message;
    message << "translation [" << translation.transpose() << "] mm: expected finite numbers";
    throw std::invalid_argument(message.str());
  }
  // Negated so that NaN fails, too.
  if (!(std::abs(rotation.norm() - 1.0) <= 1e-3))
  {
    std::ostringstream message;
    message << "quaternion xyzw [" << rotation.coeffs().transpose() << "]: expected unit norm, is " << rotation.norm();
    throw std::invalid_argument(message.str());
  }
  RigidTransform transform = RigidTransform::Identity();
  transform.linear() = rotation.normalized().toRotationMatrix();
  transform.translation() = translation;
  return transform;
}

Eigen::Matrix3d rotationFromVector(const Eigen::Vector3d& rotation_vector)
{
  const double angle = rotation_vector.stableNorm();
  if (angle == 0.0)
  {
    return Eigen::Matrix3d::Identity();
  }
  return Eigen::AngleAxisd(angle, rotation_vector / angle).toRotationMatrix();
}

Eigen::Vector3d vectorFromRotation(const Eigen::Matrix3d& rotation)
{
  const Eigen::AngleAxisd angle_axis(rotation);
  return angle_axis.angle() * angle_axis.axis();
}

RigidTransform motionAbout(const Eigen::Vector3d& centre, const Twist& twist)
{
  RigidTransform motion = RigidTransform::Identity();
  motion.linear() = rotationFromVector(twist.head<3>());
  motion.translation() = centre - motion.linear() * centre + twist.tail<3>();
  return motion;
}

Twist twistAbout(const Eigen::Vector3d& centre, const RigidTransform& motion)
{
  Twist twist;
  twist.head<3>() = vectorFromRotation(motion.linear());
  twist.tail<3>() = motion * centre - centre;
  return twist;
}

double rotationAngle(const RigidTransform& transform)
{
  return Eigen::AngleAxisd(transform.linear()).angle();
}

Eigen::Matrix3d skew(const Eigen::Vector3d& v)
{
  Eigen::Matrix3d matrix;
  matrix << 0.0, -v.z(), v.y(),  //
      v.z(), 0.0, -v.x(),        //
      -v.y(), v.x(), 0.0;
  return matrix;
}

bool isRigid(const RigidTransform& transform)
{
  const Eigen::Matrix3d rotation = transform.linear();
  return transform.matrix().allFinite() &&
         (rotation.transpose() * rotation - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() <= 1e-6 &&
         rotation.determinant() > 0.0;
}
}  // namespace xray_tracking
