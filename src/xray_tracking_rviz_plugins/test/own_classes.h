#pragma once

#include <string>
#include <vector>

#include <pluginlib/class_loader.hpp>

namespace xray_tracking
{
/// Of our plugin_description.xml, as pluginlib finds them.
template <typename Base>
std::vector<std::string> ownClasses(const std::string& base)
{
  pluginlib::ClassLoader<Base> loader("rviz", base);
  std::vector<std::string> own;
  for (const std::string& name : loader.getDeclaredClasses())
  {
    if (name.rfind("xray_tracking_rviz_plugins/", 0) == 0)
    {
      own.push_back(name);
    }
  }
  return own;
}
}  // namespace xray_tracking
