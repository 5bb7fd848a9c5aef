#include "xray_tracking_motion_estimation/region_patch.h"

#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace xray_tracking
{
TargetShape TargetShape::isotropic(const Eigen::Vector3d& centre)
{
  TargetShape shape;
  shape.centroid = centre;
  return shape;
}

TargetShape TargetShape::fromPoints(const std::vector<Eigen::Vector3d>& points)
{
  TargetShape shape;
  shape.moments.setZero();
  for (const Eigen::Vector3d& point : points)
  {
    shape.centroid += point / static_cast<double>(points.size());
  }
  for (const Eigen::Vector3d& point : points)
  {
    const Eigen::Vector3d arm = point - shape.centroid;
    shape.moments += arm * arm.transpose() / static_cast<double>(points.size());
  }
  shape.validate();
  return shape;
}

TargetShape TargetShape::about(const Eigen::Vector3d& centre, const Eigen::Matrix3d& rotation) const
{
  TargetShape shape;
  shape.centroid = rotation * (centroid - centre);
  shape.moments = rotation * moments * rotation.transpose();
  return shape;
}

void TargetShape::validate() const
{
  const Eigen::LLT<Eigen::Matrix3d> cholesky(moments);
  if (!centroid.allFinite() || !moments.allFinite() || cholesky.info() != Eigen::Success || !(cholesky.rcond() > 1e-6))
  {
    std::ostringstream message;
    message << "the target's shape has its centroid at [" << centroid.transpose() << "] mm and the moments ["
            << moments.row(0) << "; " << moments.row(1) << "; " << moments.row(2)
            << "] mm^2, expected finite numbers of points that span space";
    throw std::invalid_argument(message.str());
  }
}

RegionPatch RegionPatch::make(const ProjectionGeometry& view, const RigidTransform& room_from_patient,
                              const Eigen::Vector3d& target_centre, const TargetShape& shape,
                              const Eigen::Vector2d& region_centre)
{
  RegionPatch patch;
  patch.pixel = region_centre;
  const Eigen::Matrix3d axes = view.roomFromOptical().linear();
  const Eigen::Vector3d centroid = room_from_patient * shape.centroid;
  const double depth = view.depth(centroid);
  const Eigen::Vector2d centroid_pixel = view.project(centroid);
  const Eigen::Vector2d ray = (centroid_pixel - view.foot()).cwiseQuotient(view.focalLength());

  // The moments in oblique coordinates: along the panel, and along the ray, whose depth does not move the pixel.
  Eigen::Matrix3d oblique = Eigen::Matrix3d::Identity();
  oblique.topRightCorner<2, 1>() = -ray;
  const Eigen::Matrix3d oblique_from_patient = oblique * axes.transpose() * room_from_patient.linear();
  const Eigen::Matrix3d moments = oblique_from_patient * shape.moments * oblique_from_patient.transpose();
  const Eigen::Vector2d slope = moments.topLeftCorner<2, 2>().inverse() * moments.topRightCorner<2, 1>();
  const Eigen::Vector2d mm_per_pixel = depth * view.focalLength().cwiseInverse();
  const Eigen::Vector2d pixel_per_mm = mm_per_pixel.cwiseInverse();
  patch.moments = pixel_per_mm.asDiagonal() * moments.topLeftCorner<2, 2>() * pixel_per_mm.asDiagonal();

  Eigen::Matrix<double, 3, 2> tangents;
  tangents.topRows<2>() = Eigen::Matrix2d::Identity() + ray * slope.transpose();
  tangents.row(2) = slope.transpose();
  patch.tangents = axes * tangents * mm_per_pixel.asDiagonal();

  const double region_depth = depth + slope.dot(mm_per_pixel.cwiseProduct(region_centre - centroid_pixel));
  Eigen::Vector3d direction = Eigen::Vector3d::Ones();
  direction.head<2>() = (region_centre - view.foot()).cwiseQuotient(view.focalLength());
  patch.axis = axes * direction.normalized();
  patch.arm = view.roomFromOptical() * Eigen::Vector3d(region_depth * direction) - room_from_patient * target_centre;
  if (!(region_depth > 0.0))
  {
    patch.arm.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return patch;
}

Vector6d RegionPatch::predict(const ProjectionGeometry& view, const Eigen::Vector3d& target,
                              const Eigen::Matrix3d& rotation, Matrix6d& jacobian) const
{
  const Eigen::Vector3d moved_arm = rotation * arm;
  const Eigen::Vector3d point = target + moved_arm;
  const Eigen::Vector3d normal = view.roomFromOptical().linear().col(2);
  const double depth = view.depth(point);
  const Eigen::Matrix<double, 2, 3> projection = view.projectionJacobian(point);

  Eigen::Matrix<double, 3, 6> point_by_twist;
  point_by_twist << Eigen::Matrix3d::Identity(), -skew(moved_arm);
  Vector6d warp;
  warp.head<2>() = view.project(point) - pixel;
  jacobian.topRows<2>() = projection * point_by_twist;

  // The part of the rotation about the ray (swing-twist decomposition).
  const Eigen::Quaterniond whole(rotation);
  const Eigen::AngleAxisd twist(2.0 * std::atan2(whole.vec().dot(axis), whole.w()), axis);
  for (int column = 0; column < 2; ++column)
  {
    const Eigen::Vector3d tangent = rotation * tangents.col(column);
    const Eigen::Vector2d seen = projection * tangent;
    // Second derivative of a perspective projection P: d(P' t) = -((n h) P' t + (n t) P' h) / depth for a step h.
    Eigen::Matrix<double, 2, 6> by_motion =
        -(seen * (normal.transpose() * point_by_twist) + normal.dot(tangent) * jacobian.topRows<2>()) / depth;
    by_motion.rightCols<3>() -= projection * skew(twist * tangents.col(column));
    for (int row = 0; row < 2; ++row)
    {
      warp(2 + 2 * row + column) = seen(row);
      jacobian.row(2 + 2 * row + column) = by_motion.row(row);
    }
  }
  return warp;
}
}  // namespace xray_tracking
