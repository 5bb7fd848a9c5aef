#pragma once

#include <stdexcept>
#include <string>

#include "short_uids.h"

namespace xray_tracking
{
/// @throws std::runtime_error naming the CT's file or folder and what is wrong with it
[[noreturn]] inline void failCt(const std::string& path, const std::string& what)
{
  throw std::runtime_error(withShortUids("CT " + path + ": " + what));
}
}  // namespace xray_tracking
