#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

namespace xray_tracking
{
/// @throws std::invalid_argument "<key>: <value>, expected <lowest> to <highest>" if the value is outside; NaN is.
inline void requireInRange(const std::string& key, double value, double lowest, double highest)
{
  if (!(value >= lowest && value <= highest))
  {
    std::ostringstream text;
    text << key << ": " << value << ", expected " << lowest << " to " << highest;
    throw std::invalid_argument(text.str());
  }
}
}  // namespace xray_tracking
