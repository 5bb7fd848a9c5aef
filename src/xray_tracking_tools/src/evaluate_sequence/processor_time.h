#pragma once

#include <ctime>

namespace xray_tracking
{
/// That this process has used, on all cores [s].
inline double processorSeconds()
{
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}
}  // namespace xray_tracking
