#pragma once

#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

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
}  // namespace xray_tracking
