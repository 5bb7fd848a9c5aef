#include "xray_tracking_hyperplane_tracker/tracker_status.h"

#include <algorithm>
#include <cmath>

#include "../state_names.h"

namespace xray_tracking
{
namespace
{
/// What a person can do, where that helps.
std::string adviceFor(std::uint8_t state)
{
  using Region = xray_tracking_msgs::TrackedRegion;
  switch (state)
  {
    case Region::UNTRAINED:
      return ": needs an exposure that shows its region, or another one drawn (train_region)";
    case Region::LOST:
      return ": it is being looked for; if it stays away, look at the image, and draw the region anew";
    case Region::DEGRADED:
      return ": look for what lies over the region in the image; no tracked pose of it opens the gate";
    case Region::BLIND:
      return ": look whether X-rays are on, and blades and panel are as planned";
    default:
      return "";
  }
}
}  // namespace

void TrackerStatus::noteArrival(const ros::SteadyTime& time)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  snapshot_.last_arrival = time;
}

void TrackerStatus::noteBadStamp()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  ++snapshot_.bad_stamps;
}

void TrackerStatus::setState(std::uint8_t state)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  snapshot_.state = state;
}

void TrackerStatus::setFault(const std::string& fault)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  snapshot_.fault = fault;
}

void TrackerStatus::noteAnswer(const xray_tracking_msgs::TrackedRegion& answer, const std::string& error)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  snapshot_.state = answer.state;
  snapshot_.fault = error;
  snapshot_.correlation = answer.correlation;
  snapshot_.quality = answer.quality;
  snapshot_.cpu_ms = 1e3 * answer.cpu_time.toSec();
  snapshot_.wall_ms = 1e3 * answer.wall_time.toSec();
  snapshot_.longest_wall_ms = std::max(snapshot_.longest_wall_ms, snapshot_.wall_ms);
  ++snapshot_.exposures;
}

void TrackerStatus::report(const std::string& topic, double image_timeout, const QueueDrops& drops,
                           diagnostic_updater::DiagnosticStatusWrapper& status)
{
  Snapshot now;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    now = snapshot_;
    snapshot_.longest_wall_ms = 0.0;
  }
  const Report report{ ros::SteadyTime::now(), now.exposures, drops.overdue };
  const double elapsed = (report.time - last_report_.time).toSec();
  const std::size_t newly_overdue = report.overdue - last_report_.overdue;
  using diagnostic_msgs::DiagnosticStatus;
  const double silence = now.last_arrival ? (report.time - *now.last_arrival).toSec() : 0.0;
  if (!now.fault.empty())
  {
    status.summary(DiagnosticStatus::ERROR, now.fault);
  }
  else if (!now.last_arrival)
  {
    status.summary(DiagnosticStatus::WARN,
                   "no exposure on " + topic + " yet: does the detector's driver run, and publish there?");
  }
  else if (silence > image_timeout)
  {
    status.summaryf(DiagnosticStatus::WARN,
                    "no exposure on %s for %.1f s: look at the detector's driver and its connection", topic.c_str(),
                    silence);
  }
  else if (newly_overdue > 0)
  {
    status.summary(DiagnosticStatus::WARN,
                   "too slow: " + std::to_string(newly_overdue) +
                       " exposures dropped since the last report: lower the rate, or give it a processor");
  }
  else
  {
    status.summary(
        now.state == xray_tracking_msgs::TrackedRegion::TRACKING ? DiagnosticStatus::OK : DiagnosticStatus::WARN,
        stateName(now.state) + adviceFor(now.state));
  }
  status.add("state", stateName(now.state));
  status.add("correlation", now.correlation);
  status.add("residual, of the template's contrast", std::sqrt(std::max(0.0, 1.0 - now.correlation * now.correlation)));
  status.add("quality", now.quality);
  status.add("exposures a second", elapsed > 0.0 ? (now.exposures - last_report_.exposures) / elapsed : 0.0);
  status.add("exposures answered", now.exposures);
  status.add("exposures dropped, queue full", drops.full);
  status.add("exposures dropped, too slow", drops.overdue);
  status.add("exposures dropped, stamp not newer or in the future", now.bad_stamps);
  status.add("processor time of the last exposure [ms]", now.cpu_ms);
  status.add("image to result, last exposure [ms]", now.wall_ms);
  status.add("image to result, longest since the last report [ms]", now.longest_wall_ms);
  last_report_ = report;
}
}  // namespace xray_tracking
