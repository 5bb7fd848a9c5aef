#pragma once

#include <map>
#include <string>

#include <ros/time.h>

namespace xray_tracking
{
/// Lets each cause be logged once a second. ROS's own _THROTTLE counts all objects that log from one line as one, so
/// that one detector's warnings would hide another's. Of one thread.
class LogThrottle
{
public:
  /// Whether the cause has not been logged for a second; it is then taken to be logged now.
  bool due(const std::string& cause)
  {
    const ros::SteadyTime now = ros::SteadyTime::now();
    const auto [last, is_new] = last_.emplace(cause, now);
    if (!is_new && (now - last->second).toSec() < 1.0)
    {
      return false;
    }
    last->second = now;
    return true;
  }

private:
  std::map<std::string, ros::SteadyTime> last_;
};
}  // namespace xray_tracking
