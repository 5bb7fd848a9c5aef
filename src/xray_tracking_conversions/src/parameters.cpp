#include "xray_tracking_conversions/parameters.h"

#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <ros/console.h>

#include "xray_tracking_conversions/restart_file.h"

namespace xray_tracking
{
namespace
{
using XmlRpc::XmlRpcValue;

/// Each converts a value that is of its type, and says what it had to be if it is not; empty: it was.
std::string convert(const XmlRpcValue& found, bool& value)
{
  if (found.getType() != XmlRpcValue::TypeBoolean)
  {
    return "true or false";
  }
  value = static_cast<const bool&>(found);
  return "";
}

std::string convert(const XmlRpcValue& found, double& value)
{
  switch (found.getType())
  {
    case XmlRpcValue::TypeInt:
      value = static_cast<const int&>(found);
      return "";
    case XmlRpcValue::TypeDouble:
      value = static_cast<const double&>(found);
      return "";
    default:
      return "a number";
  }
}

std::string convert(const XmlRpcValue& found, int& value)
{
  double number = NAN;
  const bool is_number = convert(found, number).empty();
  if (!is_number || !(std::abs(number) <= std::numeric_limits<int>::max()) || number != std::trunc(number))
  {
    return "a whole number";
  }
  value = static_cast<int>(number);
  return "";
}

std::string convert(const XmlRpcValue& found, std::string& value)
{
  if (found.getType() != XmlRpcValue::TypeString)
  {
    return "a text";
  }
  value = static_cast<const std::string&>(found);
  return "";
}

std::string convert(const XmlRpcValue& found, XmlRpcValue& value)
{
  value = found;
  return "";
}

template <typename Element>
std::string convert(const XmlRpcValue& found, std::vector<Element>& value)
{
  const bool is_list = found.getType() == XmlRpcValue::TypeArray;
  value.resize(is_list ? found.size() : 1);
  for (std::size_t i = 0; i < value.size(); ++i)
  {
    const std::string expected = convert(is_list ? found[static_cast<int>(i)] : XmlRpcValue(), value[i]);
    if (!expected.empty())
    {
      return "a list of " + expected.substr(2) + "s";  // "a text"
    }
  }
  return "";
}
}  // namespace

ParameterReader::ParameterReader(const ros::NodeHandle& handle) : name_space_(handle.getNamespace())
{
  handle.getParam(name_space_, values_);
}

ParameterReader::ParameterReader(std::string name_space, const XmlRpcValue& values)
  : name_space_(std::move(name_space)), values_(values)
{
}

const XmlRpcValue* ParameterReader::find(const std::string& key) const
{
  const XmlRpcValue* value = &values_;
  std::istringstream names(key);
  for (std::string name; std::getline(names, name, '/');)
  {
    if (!value->hasMember(name))
    {
      return nullptr;
    }
    value = &(*value)[name];
  }
  return value;
}

template <typename Value>
Value ParameterReader::read(const std::string& key, const Value& fallback)
{
  read_.insert(key);
  const XmlRpcValue* found = find(key);
  Value value = fallback;
  const std::string expected = found == nullptr ? "" : convert(*found, value);
  if (!expected.empty())
  {
    std::ostringstream message;
    message << "parameter " << nameOf(key) << " is " << *found << ", expected " << expected;
    throw std::invalid_argument(message.str());
  }
  return value;
}

template bool ParameterReader::read(const std::string&, const bool&);
template int ParameterReader::read(const std::string&, const int&);
template double ParameterReader::read(const std::string&, const double&);
template std::string ParameterReader::read(const std::string&, const std::string&);
template XmlRpcValue ParameterReader::read(const std::string&, const XmlRpcValue&);
template std::vector<double> ParameterReader::read(const std::string&, const std::vector<double>&);
template std::vector<std::string> ParameterReader::read(const std::string&, const std::vector<std::string>&);

void ParameterReader::warnOfUnread() const
{
  warnOfUnread(values_, "");
}

void ParameterReader::warnOfUnread(const XmlRpcValue& values, const std::string& prefix) const
{
  if (values.getType() != XmlRpcValue::TypeStruct)
  {
    return;
  }
  for (const auto& [name, value] : values)
  {
    const std::string key = prefix + name;
    // The diagnostic updater reads its period itself, RestartFile the token.
    if (read_.count(key) != 0 || key == "diagnostic_period" || key == RestartFile::kToken)
    {
      continue;
    }
    if (value.getType() == XmlRpcValue::TypeStruct)
    {
      warnOfUnread(value, key + "/");
      continue;
    }
    ROS_WARN_STREAM(
        "parameter " << nameOf(key)
                     << " is set, but there is none of this name: it has no effect; mend its name, or leave it out");
  }
}
}  // namespace xray_tracking
