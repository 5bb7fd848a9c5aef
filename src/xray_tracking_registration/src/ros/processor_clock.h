#pragma once

#include <ctime>

namespace xray_tracking
{
/// Processor time since it was made, of the whole process, as registration uses all cores.
class ProcessorClock
{
public:
  double seconds() const { return static_cast<double>(std::clock() - start_) / CLOCKS_PER_SEC; }

private:
  std::clock_t start_ = std::clock();
};
}  // namespace xray_tracking
