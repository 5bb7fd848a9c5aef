#pragma once

#include <string>

#include <ros/ros.h>

#include "xray_tracking_motion_estimation/beam_gate.h"

namespace xray_tracking
{
/// The gate on `beam_gate`: at every change, for every exposure, and by a watchdog on wall time that nothing but the
/// end of the process or of its callback thread stops. Every transition is logged.
class BeamGateRos
{
public:
  /// @throws std::invalid_argument for bad options
  BeamGateRos(ros::NodeHandle nh, const BeamGateOptions& options);
  ~BeamGateRos() { watchdog_.stop(); }

  void update(const GateExposure& exposure);
  void refined(std::int64_t stamp, const Eigen::Vector3d& correction, double rotation, bool tracked)
  {
    logAndPublish(gate_.refined(stamp, correction, rotation, tracked));
  }
  void refused(const std::string& why, bool contradicts) { logAndPublish(gate_.refused(why, contradicts)); }
  void doubt(const std::string& why) { logAndPublish(gate_.doubt(why)); }
  void reset(const std::string& why) { logAndPublish(gate_.reset(why)); }

  const BeamGate& gate() const { return gate_; }

private:
  void watchdogCb(const ros::SteadyTimerEvent& event);
  void logAndPublish(bool changed);

  BeamGate gate_;
  ros::Time exposure_;  ///< stamp of the latest exposure
  ros::Publisher publisher_;
  ros::SteadyTimer watchdog_;
};

/// Monotonic clock [ns].
std::int64_t steadyNanoseconds();
}  // namespace xray_tracking
