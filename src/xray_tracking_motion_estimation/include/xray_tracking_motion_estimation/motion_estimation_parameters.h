#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <ros/node_handle.h>

#include "xray_tracking_motion_estimation/beam_gate.h"
#include "xray_tracking_motion_estimation/consistency_monitor.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"

namespace xray_tracking
{
/// Parameters of the node motion_estimation; README.md lists them.
struct MotionEstimationParameters
{
  std::string setup_file;
  std::vector<std::string> detectors;
  bool bone_shape = false;  ///< the target's shape is that of its bone; otherwise it is not known
  MotionEstimationOptions estimation;
  ConsistencyOptions consistency;
  ConsistencyOptions rigid_consistency;  ///< beyond which the views of a rigid target differ
  PosePredictorOptions prediction;
  BeamGateOptions gate;
  RefinementPolicyOptions refinement;
  int queue_size = 100;            ///< exposures
  double view_timeout = 2.0;       ///< [s]
  double pairing_tolerance = 0.0;  ///< of the stamps of one exposure [s]
  double target_speed = 15.0;      ///< standard deviation along any axis [mm/s], for what a tolerance lets through
};

/// Of the node's private namespace; warns of parameters that it does not know.
/// @throws std::invalid_argument naming the parameter, its value and what was expected
MotionEstimationParameters readMotionEstimationParameters(const ros::NodeHandle& pnh);
}  // namespace xray_tracking
