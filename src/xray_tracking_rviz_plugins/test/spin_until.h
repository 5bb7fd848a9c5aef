#pragma once

#include <chrono>
#include <functional>

#include <QApplication>

#include <ros/time.h>

namespace xray_tracking
{
/// Lets the windows live until the condition holds. @return whether it did in time [s]
inline bool spinUntil(const std::function<bool()>& condition, double seconds = 10.0)
{
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (!condition())
  {
    if (std::chrono::steady_clock::now() > end)
    {
      return false;
    }
    QApplication::processEvents(QEventLoop::AllEvents, 10);
    ros::WallDuration(0.002).sleep();
  }
  return true;
}

/// Lets the windows live for so long. [s]
inline void spin(double seconds)
{
  spinUntil([] { return false; }, seconds);
}
}  // namespace xray_tracking
