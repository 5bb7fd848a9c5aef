#pragma once

#include <sstream>
#include <string>

namespace xray_tracking
{
/// Text of all parts, numbers in three digits.
template <typename... Parts>
std::string message(const Parts&... parts)
{
  std::ostringstream text;
  text.precision(3);
  (text << ... << parts);
  return text.str();
}
}  // namespace xray_tracking
