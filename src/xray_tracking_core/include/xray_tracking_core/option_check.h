#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

namespace xray_tracking
{
/// @throws std::invalid_argument "<key> is <value>, expected <expected>" unless `good`
template <typename Value>
void requireOption(bool good, const std::string& key, const Value& value, const std::string& expected)
{
  if (!good)
  {
    std::ostringstream text;
    text << key << " is " << value << ", expected " << expected;
    throw std::invalid_argument(text.str());
  }
}

/// @throws std::invalid_argument, as requireOption, if the value is outside of lowest .. highest; NaN is.
inline void requireInRange(const std::string& key, double value, double lowest, double highest)
{
  std::ostringstream range;
  range << lowest << " to " << highest;
  requireOption(value >= lowest && value <= highest, key, value, range.str());
}
}  // namespace xray_tracking
