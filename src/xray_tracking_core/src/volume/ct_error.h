#pragma once

#include <stdexcept>
#include <string>

namespace xray_tracking
{
/// @throws std::runtime_error naming the CT's file or folder and what is wrong with it
[[noreturn]] inline void failCt(const std::string& path, const std::string& what)
{
  throw std::runtime_error("CT " + path + ": " + what);
}
}  // namespace xray_tracking
