#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>

#include "xray_tracking_conversions/log_throttle.h"
#include "xray_tracking_motion_estimation/motion_monitor.h"

namespace xray_tracking
{
/// What the assembly of exposures has dropped.
struct AssemblyCounts
{
  std::size_t pending = 0;
  std::size_t incomplete = 0;
  std::size_t duplicates = 0;
  std::size_t late = 0;
  std::size_t future = 0;
};

/// A detector as people are told of it.
struct ViewReport
{
  std::string name;
  std::string topic;
  std::string camera_info_fault;  ///< empty if there is none
  bool silent = false;
};

/// What the node tells people of its work: log and diagnostics.
class MotionReport
{
public:
  void add(const MotionDecision& decision);

  /// What changes within a state, once a second. @param monitor null if the node is idle
  void log(const MotionMonitor& monitor, const std::vector<ViewReport>& views, const AssemblyCounts& counts);

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status, const MotionMonitor& monitor,
                const std::vector<ViewReport>& views, const AssemblyCounts& counts);

private:
  struct Logged
  {
    std::string doubt;  ///< while the others made a pose
    std::string fault;  ///< of camera_info
    bool silent = false;
  };
  void logMotion();

  std::optional<MotionDecision> last_;
  std::optional<std::pair<MotionState, PoseSource>> logged_motion_;
  LogThrottle throttle_;
  std::string logged_reason_;
  std::vector<Logged> logged_;
  std::size_t drops_at_last_warning_ = 0;
  ros::SteadyTime last_exposure_;  ///< when the last decision was made
  ros::SteadyTime last_diagnosis_ = ros::SteadyTime::now();
  std::size_t exposures_ = 0;
  std::size_t exposures_at_last_diagnosis_ = 0;
  std::size_t tracked_ = 0;
  std::size_t registered_ = 0;
  std::size_t differing_ = 0;  ///< exposures whose views differed
};
}  // namespace xray_tracking
