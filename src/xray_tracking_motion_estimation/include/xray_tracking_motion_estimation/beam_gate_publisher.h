#pragma once

#include <ros/ros.h>

#include "xray_tracking_conversions/log_throttle.h"
#include "xray_tracking_motion_estimation/beam_gate.h"

namespace xray_tracking
{
/// The gate on `beam_gate`. Of all messages only the latest is kept for a link that stalls, and each says until when it
/// is valid: an old "open" is none.
class BeamGatePublisher
{
public:
  explicit BeamGatePublisher(ros::NodeHandle nh);

  /// To be called at every change, for every exposure, and every kPeriod by a watchdog on the monotonic clock. Logs
  /// when it opens and closes, and changes of the reason, each once a second.
  /// @param exposure stamp of the latest exposure; @param now monotonic clock [ns]
  void publish(const BeamGate& gate, const ros::Time& exposure, std::int64_t now);

  static constexpr double kPeriod = 0.02;  ///< [s]

private:
  ros::Publisher publisher_;
  GateReason logged_ = GateReason::NO_EXPOSURE;
  LogThrottle throttle_;
};
}  // namespace xray_tracking
