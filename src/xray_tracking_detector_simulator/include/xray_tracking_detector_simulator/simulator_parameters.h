#pragma once

#include <cstdint>
#include <string>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_detector_simulator/image_formation.h"
#include "xray_tracking_detector_simulator/simulated_motion.h"

namespace xray_tracking
{
/// The node's private parameters (README.md), with their defaults.
struct SimulatorParameters
{
  std::string source = "phantom";
  std::string setup_file;
  double rate = 10.0;  ///< [Hz]
  int exposures = 0;   ///< 0: endless
  int seed = 1;
  bool wait_for_start = false;
  ImageFormationOptions image;
  MotionOptions motion;
};

/// @throws std::invalid_argument naming the parameter, its value and what was expected
SimulatorParameters readParameters(ParameterReader reader);
}  // namespace xray_tracking
