#pragma once

#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// How what the trackers see is spread in space. A warp of at most six parameters sees no more of it than this.
struct TargetShape
{
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();     ///< patient frame [mm]
  Eigen::Matrix3d moments = Eigen::Matrix3d::Identity();  ///< covariance about it, positive definite [mm^2]

  /// Nothing known: depth has nothing to do with the place in the image, so that an out-of-plane rotation stays unseen.
  static TargetShape isotropic(const Eigen::Vector3d& centre);
  /// Of points of the tracked bone, patient frame [mm]. @throws std::invalid_argument if they do not span space
  static TargetShape fromPoints(const std::vector<Eigen::Vector3d>& points);

  /// The same seen from `centre` (patient frame), in axes that are turned by `rotation`.
  TargetShape about(const Eigen::Vector3d& centre, const Eigen::Matrix3d& rotation) const;

  /// @throws std::invalid_argument naming what is not finite or not positive definite
  void validate() const;
};

/// What a view's region is to a 6-parameter warp: a point with a tangent plane, of the target at the exposure that the
/// view was trained on. The plane is the best linear guess of depth from the place in the image.
struct RegionPatch
{
  Eigen::Vector3d arm = Eigen::Vector3d::Zero();  ///< from the target's centre to the region's, room [mm]
  Eigen::Matrix<double, 3, 2> tangents = Eigen::Matrix<double, 3, 2>::Zero();  ///< along columns and rows [mm / px]
  Eigen::Matrix2d moments = Eigen::Matrix2d::Identity();                       ///< of the target's projection [px^2]
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();                             ///< of the region's centre
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  ///< of its ray, unit: rotations about it are in-plane

  /// @param region_centre in the reference exposure [px]
  /// @return a patch with entries that are not finite if the region is not in front of the source
  static RegionPatch make(const ProjectionGeometry& view, const RigidTransform& room_from_patient,
                          const Eigen::Vector3d& target_centre, const TargetShape& shape,
                          const Eigen::Vector2d& region_centre);

  bool allFinite() const { return arm.allFinite() && tangents.allFinite() && moments.allFinite(); }

  /// The warp (dx, dy, l11, l12, l21, l22) by exact perspective at the region's centre.
  ///
  /// The derivative leaves out that a region turned out of the plane is flattened further by turning it on: flattening,
  /// 0.1 % at 2.5 degrees, is the same for both signs, so that following it would fit a rotation to noise and be
  /// certain of the wrong one half of the time. It is exact where the rotation is about the ray.
  /// @param target where the target's centre is now, room [mm]
  /// @param rotation of the target since the reference exposure, room axes
  /// @param jacobian out: derivative with respect to (the target's centre [mm], a further rotation vector about it
  /// [rad])
  Vector6d predict(const ProjectionGeometry& view, const Eigen::Vector3d& target, const Eigen::Matrix3d& rotation,
                   Matrix6d& jacobian) const;
};
}  // namespace xray_tracking
