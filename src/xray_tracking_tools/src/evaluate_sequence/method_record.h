#pragma once

#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"
#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
/// What a method says of an exposure, its pose apart. Empty or not a number where it does not say it.
struct ExposureRecord
{
  std::string source;  ///< tracked or registered; none without a pose
  std::string reason;  ///< why there is no pose, or why it is not a registered one
  std::string gate;    ///< why the beam is held, as gateReasonName(); NONE: it is not
  std::string gate_text;
  double disagreement_px = std::numeric_limits<double>::quiet_NaN();
  double chi_square = std::numeric_limits<double>::quiet_NaN();
  int degrees_of_freedom = 0;
  std::optional<PoseCovariance> covariance;
  std::vector<TrackedView> views;
  double cpu_s = 0.0;
  double wall_s = 0.0;
  double registration_cpu_s = std::numeric_limits<double>::quiet_NaN();
};

/// Of all exposures of one method.
struct MethodRecord
{
  std::string method;
  std::vector<ExposureRecord> exposures;
};

/// Writes gold_standard.csv (if there is one), exposures.csv, views.csv and times.csv (docs/evaluation.md, "Files").
/// @param detectors names, in the order of the views
/// @throws std::runtime_error naming a file that cannot be written
void writeRecords(const Evaluation& evaluation, const std::vector<MethodRecord>& records,
                  const std::vector<std::string>& detectors, const std::string& folder);
}  // namespace xray_tracking
