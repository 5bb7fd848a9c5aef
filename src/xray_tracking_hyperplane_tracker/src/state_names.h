#pragma once

#include <cstdint>

namespace xray_tracking
{
/// Of TrackedRegion's states, for people.
inline const char* stateName(std::uint8_t state)
{
  static const char* const kNames[] = { "untrained", "training", "tracking", "lost", "degraded", "blind" };
  return kNames[state];
}
}  // namespace xray_tracking
