#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_motion_estimation/region_patch.h"
#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// What an arrangement of views tells of a target's motion, for tracks that are wrong by a pixel. Directions are
/// columns, room axes, worst first.
struct Observability
{
  Eigen::Matrix3d translation_directions;
  Eigen::Vector3d translation;  ///< standard deviation [mm / px]; infinity where nothing is seen
  Eigen::Matrix3d rotation_directions;
  Eigen::Vector3d rotation;  ///< about the target's centre [rad / px]; infinity where nothing is seen

  /// Worst over best direction of translation: 1.4 for two orthogonal views.
  double condition() const { return translation(0) / translation(2); }
};

/// @param target room [mm]
/// @param shape how the tracked target is spread, in room axes about `target`
/// @param extent distance from the region's centre at which an error of the linear part makes a pixel [mm], > 0: about
///   the root mean square distance of the target's points
/// Every component of every track has an independent error. Translation and rotation are each judged with the other one
/// known.
/// @throws std::invalid_argument for no views, a target that is not in front of every source, or a bad extent
Observability observability(const std::vector<ProjectionGeometry>& views, const Eigen::Vector3d& target,
                            const TargetShape& shape, TrackModel model, double extent);

/// As a text for people: worst direction, mm a pixel, condition, what rotation is seen.
std::string describe(const Observability& observability);
}  // namespace xray_tracking
