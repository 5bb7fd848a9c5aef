#pragma once

#include <string>

#include "xray_tracking_motion_estimation/beam_gate.h"
#include "xray_tracking_motion_estimation/exposure_estimator.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"

namespace xray_tracking
{
/// Which poses are published.
enum class PoseMethod
{
  TRACKING,                  ///< tracked ones; registrations move what they count from
  REGISTRATION,              ///< registered ones, found from the last one on
  TRACKING_AND_REGISTRATION  ///< registered ones, found from the tracked pose on; where there is none, tracked ones
};

/// @throws std::invalid_argument if `name` is none of tracking, registration, tracking_and_registration
PoseMethod poseMethodFromName(const std::string& name);
const char* poseMethodName(PoseMethod method);

/// The members' defaults but for what patients ask for; as the node's parameters.
struct MotionMonitorOptions
{
  MotionMonitorOptions();

  PoseMethod method = PoseMethod::TRACKING;
  /// How long an exposure waits, from when it was tracked, for its registered pose [s], 0 to 10.
  double deadline = 0.1;
  ExposureEstimatorOptions tracks;
  double rigid_sigma =
      0.027;  ///< floor of ConsistencyOptions for a rigid target, which `views_differ` follows from, > 0
  PosePredictorOptions prediction;
  BeamGateOptions gate;
  RefinementPolicyOptions refinement;

  /// Sets what follows from other members: what the consistency monitors, the prediction, the gate and the refinement
  /// have to know of the rest. @throws std::invalid_argument naming the key, its value and what was expected
  void derive();
};
}  // namespace xray_tracking
