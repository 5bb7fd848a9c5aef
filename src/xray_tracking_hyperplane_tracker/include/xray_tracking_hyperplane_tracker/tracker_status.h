#pragma once

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/time.h>

#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_hyperplane_tracker/bounded_queue.h"

namespace xray_tracking
{
/// What diagnostics tell of a tracker: several threads leave what they know, one reports. Thread-safe.
class TrackerStatus
{
public:
  /// An exposure has come.
  void noteArrival(const ros::SteadyTime& time);
  /// One was dropped for its stamp.
  void noteBadStamp();
  /// What the tracker is at, between answers.
  void setState(std::uint8_t state);
  /// Of the configuration, for as long as the node lives.
  void setFault(const std::string& fault);
  /// An exposure is answered. @param error what went wrong with it; empty: nothing
  void noteAnswer(const xray_tracking_msgs::TrackedRegion& answer, const std::string& error);

  /// All of it, and what has happened since the last report. By one thread alone.
  /// @param topic of the images; @param image_timeout silence on it that is worth a warning [s]
  /// @param drops by the queue, since the start
  void report(const std::string& topic, double image_timeout, const QueueDrops& drops,
              diagnostic_updater::DiagnosticStatusWrapper& status);

private:
  struct Snapshot
  {
    std::uint8_t state = xray_tracking_msgs::TrackedRegion::UNTRAINED;
    std::string fault;  ///< of the configuration or the last exposure; empty: none
    double correlation = 0.0;
    double quality = 0.0;
    double cpu_ms = 0.0;
    double wall_ms = 0.0;
    double longest_wall_ms = 0.0;  ///< since the last report
    std::size_t exposures = 0;
    std::size_t bad_stamps = 0;
    std::optional<ros::SteadyTime> last_arrival;
  };
  /// What the last report was, for what has happened since.
  struct Report
  {
    ros::SteadyTime time;
    std::size_t exposures = 0;
    std::size_t overdue = 0;
  };

  std::mutex mutex_;
  Snapshot snapshot_;
  Report last_report_{ ros::SteadyTime::now(), 0, 0 };
};
}  // namespace xray_tracking
