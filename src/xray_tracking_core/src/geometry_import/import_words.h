#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

#include <Eigen/Core>

namespace xray_tracking
{
[[noreturn]] inline void fail(const std::string& where, const std::string& what)
{
  throw std::runtime_error(where + ": " + what);
}

template <typename... Parts>
std::string sentence(const Parts&... parts)
{
  std::ostringstream text;
  (text << ... << parts);
  return text.str();
}

inline std::string listOf(const Eigen::VectorXd& vector)
{
  std::ostringstream text;
  text << vector.format(Eigen::IOFormat(6, Eigen::DontAlignCols, ", ", ", "));
  return "[" + text.str() + "]";
}

/// A place [mm], without what rounding leaves of zeros.
inline std::string placeOf(const Eigen::Vector3d& mm)
{
  return listOf(((mm.array() * 1e6).round() / 1e6 + 0.0).matrix());
}
}  // namespace xray_tracking
