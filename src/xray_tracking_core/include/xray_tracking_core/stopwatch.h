#pragma once

#include <chrono>

#include <time.h>

namespace xray_tracking
{
/// Seconds since construction: on the clock, and of processor time that the constructing thread, which has to be the
/// asking one, has used.
class Stopwatch
{
public:
  double wallSeconds() const
  {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - wall_start_).count();
  }
  double cpuSeconds() const { return threadSeconds() - cpu_start_; }

private:
  static double threadSeconds()
  {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }

  std::chrono::steady_clock::time_point wall_start_ = std::chrono::steady_clock::now();
  double cpu_start_ = threadSeconds();
};
}  // namespace xray_tracking
