#pragma once

#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <XmlRpcValue.h>
#include <ros/console.h>
#include <ros/node_handle.h>

#include "xray_tracking_conversions/restart_file.h"

namespace xray_tracking
{
namespace detail
{
inline const char* typeName(bool)
{
  return "true or false";
}
inline const char* typeName(int)
{
  return "a whole number";
}
inline const char* typeName(double)
{
  return "a number";
}
inline const char* typeName(const std::string&)
{
  return "a text";
}
inline const char* typeName(const std::vector<std::string>&)
{
  return "a list of texts";
}
inline const char* typeName(const std::vector<double>&)
{
  return "a list of numbers";
}
}  // namespace detail

/// A node's parameter, or `fallback` if it is not set; roscpp's own param() takes a value of the wrong type for one
/// that is not set. @throws std::invalid_argument naming the parameter, its value and the expected type
template <typename Value>
Value readParameter(const ros::NodeHandle& handle, const std::string& key, const Value& fallback)
{
  Value value = fallback;
  if (handle.hasParam(key) && !handle.getParam(key, value))
  {
    XmlRpc::XmlRpcValue found;
    handle.getParam(key, found);
    std::ostringstream message;
    message << "parameter " << handle.resolveName(key) << " is " << found << ", expected "
            << detail::typeName(fallback);
    throw std::invalid_argument(message.str());
  }
  return value;
}

/// Reads a node's private parameters and knows which ones are there in vain: a misspelt name is otherwise taken for a
/// parameter that is not set.
class ParameterReader
{
public:
  /// @param handle of the node's private namespace
  explicit ParameterReader(const ros::NodeHandle& handle) : handle_(handle) {}

  /// As readParameter().
  template <typename Value>
  Value read(const std::string& key, const Value& fallback)
  {
    read_.insert(handle_.resolveName(key));
    return readParameter(handle_, key, fallback);
  }

  /// Logs a warning for every parameter in the namespace that has not been read. Call it when all have been.
  void warnOfUnread() const
  {
    const std::string name_space = handle_.getNamespace() + "/";
    std::vector<std::string> names;
    handle_.getParamNames(names);
    for (const std::string& name : names)
    {
      // The diagnostic updater reads its period itself, RestartFile the token.
      if (name.compare(0, name_space.size(), name_space) == 0 && read_.count(name) == 0 &&
          name != name_space + "diagnostic_period" && name != name_space + RestartFile::kToken)
      {
        ROS_WARN_STREAM("parameter "
                        << name
                        << " is set, but there is none of this name: it has no effect; mend its name, or leave it out");
      }
    }
  }

private:
  ros::NodeHandle handle_;
  std::set<std::string> read_;  ///< resolved
};
}  // namespace xray_tracking
