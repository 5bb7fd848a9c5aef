#pragma once

#include <string>
#include <utility>
#include <vector>

#include <boost/math/constants/constants.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_tools/finding.h"

namespace xray_tracking
{
// What the graph asks of an initial pose (docs/playback.md).
constexpr double kNearMm = 10.0;
constexpr double kNearRotation = 5.0 * boost::math::constants::degree<double>();

/// Another meaning of what is written in a setup.
struct PoseReading
{
  std::string words;
  RigidTransform room_from_patient;
  bool swapped = false;     ///< the first two detectors
  bool other_tone = false;  ///< the other kind of intensity
};

/// How far apart two poses put the target: distance of its centre [mm], angle [rad].
std::pair<double, double> apart(const RigidTransform& a, const RigidTransform& b, const Eigen::Vector3d& centre);

/// What the setup's initial pose may have been meant to be: those that differ from it, and from each other.
std::vector<PoseReading> otherReadings(const TreatmentSetup& setup);

/// How much of the target's box a pose puts into the image that has least of it, 0..1 of its projection; 0 if it is
/// behind a source.
double targetShare(const TreatmentSetup& setup, const RigidTransform& room_from_patient);

/// Detectors that no room has, those that do not see the target at the initial pose, and which of its other readings
/// all of them would see.
std::vector<Finding> checkRoom(const TreatmentSetup& setup);
}  // namespace xray_tracking
