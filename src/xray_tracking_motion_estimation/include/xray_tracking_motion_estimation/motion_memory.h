#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"
#include "xray_tracking_motion_estimation/view_clarity.h"
#include "xray_tracking_motion_estimation/view_references.h"

namespace xray_tracking
{
/// What poses count from: with it another MotionMonitor goes on where one has died, beside trackers that keep their
/// templates. None of it is verified there, see MotionMonitor::takeUp().
struct MotionMemory
{
  /// What each view's track is relative to; nothing of a view that has not been tracked.
  std::vector<std::optional<ViewReference>> references;
  std::vector<ViewSight> sights;                          ///< one a view
  RigidTransform reference = RigidTransform::Identity();  ///< ExposureEstimator::reference()
  Matrix6d reference_covariance = Matrix6d::Zero();       ///< of the target's centre [mm] and rotation [rad]
  std::int64_t last_stamp = 0;                            ///< of the last exposure with a pose [ns]
  RigidTransform last_pose = RigidTransform::Identity();
  std::string doubt;  ///< why that pose was not verified; empty if it was
};

/// What is kept of a run: the detectors, what people said to the gate, and what poses count from, if anything yet.
struct RunMemory
{
  std::vector<DetectorDescription> detectors;  ///< as they were; empty before their geometry was known
  std::optional<MotionMemory> motion;
  std::string hold;               ///< why people hold the beam; empty if they do not
  bool operator_present = false;  ///< whether an operator's panel was ever heard
};

/// As text, without loss.
std::string textOf(const RunMemory& memory);
/// @throws std::invalid_argument saying what is wrong: no such text, numbers that are not finite, a rotation or a
/// covariance that is none
RunMemory runMemoryFrom(const std::string& text);

/// What is different now; empty if these are the same detectors, to rounding.
std::string difference(const std::vector<DetectorDescription>& then, const std::vector<ProjectionGeometry>& now);
}  // namespace xray_tracking
