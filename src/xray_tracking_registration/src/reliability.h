#pragma once

#include <string>

#include "gauss_newton.h"

namespace xray_tracking
{
/// How well the target's twist about its centre in the room [rad, mm] is known.
struct PoseSpread
{
  /// From the spread over tiles of the images: what noise, and what the model does not know of, do to the pose.
  Eigen::Matrix<double, 6, 6> tiles;
  /// The pose's covariance: the same, steadied, as that of few tiles in six directions is too small in some.
  Eigen::Matrix<double, 6, 6> covariance;
};
PoseSpread poseSpread(const std::vector<ViewLevel>& views, const Linearisation& at, const RestPrior& prior,
                      const PosePair& poses, const Bodies& bodies);

/// Figures of each view but its coarse similarity. @param room_centre the target's centre in the room
std::vector<ViewResidual> viewResiduals(const std::vector<ViewLevel>& views, const Linearisation& at,
                                        const Eigen::Vector3d& room_centre);

/// The motion of the target, by 1 mm root mean square over its box, along which its pose is known least: a twist about
/// its centre in the room [rad, mm].
Twist leastKnown(const Eigen::Matrix<double, 6, 6>& covariance, const RigidTransform& room_from_patient,
                 const Eigen::AlignedBox3d& box);

/// Root mean square over the box's corners of what the pose's covariance moves them by [mm].
/// @param box in the patient frame, about whose centre the covariance is
double expectedError(const Eigen::Matrix<double, 6, 6>& covariance, const RigidTransform& room_from_patient,
                     const Eigen::AlignedBox3d& box);
}  // namespace xray_tracking
