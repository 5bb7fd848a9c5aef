#include "xray_tracking_motion_estimation/motion_estimation_parameters.h"

#include <cmath>
#include <set>
#include <stdexcept>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
/// Reads the parameters of one namespace; what is wrong with a value is told with the namespace.
class Group
{
public:
  Group(ParameterReader& reader, std::string name_space) : reader_(reader), name_space_(std::move(name_space)) {}

  template <typename Value>
  void read(const std::string& key, Value& value)
  {
    value = reader_.read(name_space_ + key, value);
  }

  template <typename Options>
  void validate(const Options& options) const
  {
    try
    {
      options.validate();
    }
    catch (const std::invalid_argument& error)
    {
      throw std::invalid_argument(name_space_ + error.what());
    }
  }

private:
  ParameterReader& reader_;
  std::string name_space_;
};
}  // namespace

MotionEstimationParameters readMotionEstimationParameters(ParameterReader reader)
{
  MotionEstimationParameters parameters;

  Group own(reader, "");
  own.read("setup_file", parameters.setup_file);
  MotionMonitorOptions& monitor = parameters.monitor;
  ExposureEstimatorOptions& tracks = monitor.tracks;
  tracks.views = { "detector_a", "detector_b" };
  own.read("detectors", tracks.views);
  std::string method = "tracking";
  own.read("method", method);
  MotionEstimationOptions& estimation = tracks.estimation;
  std::string estimation_method = "least_squares";
  own.read("estimation_method", estimation_method);
  std::string target_shape = "isotropic";
  own.read("target_shape", target_shape);
  own.read("significance", estimation.significance);
  own.read("floor_sigma", estimation.floor_sigma);
  own.read("linear_floor_sigma", estimation.linear_floor_sigma);
  own.read("rotation_sigma", estimation.rotation_sigma);
  own.read("tissue_sigma", estimation.tissue_sigma);
  own.read("tissue_time", estimation.tissue_time);
  own.read("min_view_angle", estimation.min_view_angle);
  own.read("queue_size", parameters.queue_size);
  own.read("view_timeout", parameters.view_timeout);
  own.read("keep_for_restart", parameters.keep_for_restart);
  own.read("pairing_tolerance", tracks.pairing_tolerance);
  own.read("target_speed", tracks.target_speed);

  Group pose(reader, "pose/");
  pose.read("deadline", monitor.deadline);

  Group consistency(reader, "consistency/");
  consistency.read("window", tracks.consistency.window);
  consistency.read("significance", tracks.consistency.significance);
  consistency.read("persistent_sigma", tracks.consistency.persistent_sigma);
  consistency.read("rigid_sigma", monitor.rigid_sigma);

  Group prediction(reader, "prediction/");
  prediction.read("latency", monitor.prediction.latency);
  prediction.read("max_gap", monitor.prediction.max_gap);

  Group gate(reader, "gate/");
  gate.read("max_age", monitor.gate.max_age);
  gate.read("max_interval", monitor.gate.max_interval);
  gate.read("max_displacement", monitor.gate.max_displacement);
  gate.read("max_rotation", monitor.gate.max_rotation);
  gate.read("max_sigma", monitor.gate.max_sigma);
  gate.read("max_tracked_sigma", monitor.gate.max_tracked_sigma);
  gate.read("max_speed", monitor.gate.max_speed);
  gate.read("good_exposures", monitor.gate.good_exposures);
  gate.read("jump_exposures", monitor.gate.jump_exposures);
  gate.read("initial_pose_verified", monitor.gate.verification.initial_pose_verified);
  gate.read("max_unverified_time", monitor.gate.verification.max_unverified_time);
  gate.read("max_unverified_exposures", monitor.gate.verification.max_unverified_exposures);
  gate.read("operator_silence", monitor.gate.hold.operator_silence);

  Group refinement(reader, "refinement/");
  std::string mode = "never";
  refinement.read("mode", mode);
  refinement.read("every_n", monitor.refinement.every_n);
  refinement.read("drift", monitor.refinement.drift);
  refinement.read("drift_rotation", monitor.refinement.drift_rotation);
  refinement.read("drift_residual", monitor.refinement.drift_residual);
  refinement.read("timeout", monitor.refinement.timeout);
  refinement.read("max_correction", monitor.refinement.max_correction);
  refinement.read("max_correction_rotation", monitor.refinement.max_correction_rotation);
  refinement.read("min_similarity", monitor.refinement.min_similarity);
  refinement.read("significance", monitor.refinement.significance);
  reader.warnOfUnread();

  monitor.method = poseMethodFromName(method);
  estimation.method = estimationMethodFromName(estimation_method);
  monitor.refinement.mode = refinementModeFromName(mode);
  requireOption(target_shape == "isotropic" || target_shape == "bone", "target_shape", "'" + target_shape + "'",
                "isotropic or bone");
  parameters.bone_shape = target_shape == "bone";
  own.validate(estimation);
  monitor.derive();
  consistency.validate(tracks.consistency);
  prediction.validate(monitor.prediction);
  gate.validate(monitor.gate);
  refinement.validate(monitor.refinement);
  requireOption(parameters.queue_size >= 1, "queue_size", parameters.queue_size, "1 or more exposures");
  requireOption(parameters.view_timeout > 0.0, "view_timeout", parameters.view_timeout, "a number > 0 s");
  requireOption(tracks.pairing_tolerance >= 0.0 && tracks.pairing_tolerance <= 1.0, "pairing_tolerance",
                tracks.pairing_tolerance, "0 to 1 s, less than half the time between exposures");
  requireOption(tracks.target_speed >= 0.0 && tracks.target_speed <= 1e4, "target_speed", tracks.target_speed,
                "0 to 10000 mm/s");
  const std::vector<std::string>& names = tracks.views;
  requireOption(names.size() >= 2 && names.size() <= kMaxViews &&
                    std::set<std::string>(names.begin(), names.end()).size() == names.size(),
                "the length of detectors", names.size(), "2 to " + std::to_string(kMaxViews) + " names that differ");
  if (parameters.setup_file.empty())
  {
    throw std::invalid_argument("parameter " + reader.nameOf("setup_file") +
                                " is not set, expected the path of a setup file");
  }
  return parameters;
}
}  // namespace xray_tracking
