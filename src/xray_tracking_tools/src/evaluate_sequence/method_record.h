#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"
#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
class CsvTable;

/// What a method says of an exposure, its pose apart. Empty or not a number where it does not say it.
struct ExposureRecord
{
  std::string source;  ///< tracked or registered; none without a pose
  std::string reason;  ///< why there is no pose, or why it is not a registered one
  std::string gate;    ///< why the beam is held, as gateReasonName(); NONE: it is not
  std::string gate_text;
  std::string unverified;  ///< why nothing says that the pose is right; empty where it is verified
  double disagreement_px = std::numeric_limits<double>::quiet_NaN();
  double chi_square = std::numeric_limits<double>::quiet_NaN();
  int degrees_of_freedom = 0;
  std::optional<PoseCovariance> covariance;
  std::vector<TrackedView> views;
  double cpu_s = 0.0;
  double wall_s = 0.0;
  double registration_cpu_s = std::numeric_limits<double>::quiet_NaN();
};

/// Writes what methods say of exposures as they say it, so that a long recording takes no memory: exposures.csv,
/// views.csv and times.csv (docs/evaluation.md, "Files").
class RecordWriter
{
public:
  /// @param detectors names, in the order of the views
  /// @throws std::runtime_error naming a file that cannot be written, as all others do
  RecordWriter(const std::string& folder, const std::vector<std::string>& detectors);
  ~RecordWriter();

  void add(std::size_t frame, std::int64_t stamp_ns, const std::string& method, const ExposureRecord& record);
  void close();

private:
  std::vector<std::string> detectors_;
  std::unique_ptr<CsvTable> exposures_;
  std::unique_ptr<CsvTable> views_;
  std::unique_ptr<CsvTable> times_;
};

/// Writes gold_standard.csv, or removes that of an earlier evaluation if there is no gold standard.
void writeGoldStandard(const Evaluation& evaluation, const std::string& folder);
}  // namespace xray_tracking
