#pragma once

#include <algorithm>
#include <cstdint>
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

/// Of a file's voxels or pixels, before there is memory for them: it may claim any number of them.
/// @param stored size of the file [bytes]; @param claimed size of what it says it holds [bytes]
/// @throws std::runtime_error naming the file if no compression of images packs so much in it
inline void requireHeld(const std::string& path, std::uintmax_t stored, double claimed)
{
  constexpr double kMostPacked = 2000.0;     // deflate: 1032
  constexpr double kSmall = 64.0 * 1048576;  // whatever is in it, and however it is packed [bytes]
  if (!(claimed <= std::max(kSmall, kMostPacked * static_cast<double>(stored))))
  {
    throw std::runtime_error(path + ": truncated: " + std::to_string(stored) + " bytes cannot hold the " +
                             std::to_string(static_cast<std::uintmax_t>(std::min(claimed, 1e18))) +
                             " that its header says");
  }
}
}  // namespace xray_tracking
