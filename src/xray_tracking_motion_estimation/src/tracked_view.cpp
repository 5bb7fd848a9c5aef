#include "xray_tracking_motion_estimation/tracked_view.h"

#include <cstddef>

namespace xray_tracking
{
const char* motionStateName(MotionState state)
{
  static const char* const kNames[] = { "OK",           "WAITING",   "LOST",        "INCONSISTENT",
                                        "NO_REFERENCE", "BAD_STAMP", "UNREGISTERED" };
  return kNames[static_cast<std::size_t>(state)];
}
}  // namespace xray_tracking
