#pragma once

#include <string>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_motion_estimation/motion_monitor.h"

namespace xray_tracking
{
/// Parameters of the node motion_estimation; README.md lists them.
struct MotionEstimationParameters
{
  std::string setup_file;
  bool bone_shape = false;  ///< the target's shape is that of its bone; otherwise it is not known
  MotionMonitorOptions monitor;
  int queue_size = 100;           ///< exposures that wait for the rest of their views
  double view_timeout = 2.0;      ///< [s]
  bool keep_for_restart = false;  ///< on disk, what a node in the place of this one goes on from
};

/// Of the node's private namespace; warns of parameters that it does not know.
/// @throws std::invalid_argument naming the parameter, its value and what was expected
MotionEstimationParameters readMotionEstimationParameters(ParameterReader reader);
}  // namespace xray_tracking
