#pragma once

#include <set>
#include <string>
#include <vector>

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

namespace xray_tracking
{
/// A node's private parameters, as they stood when this was made. Knows which ones are there in vain: a misspelt name
/// is otherwise taken for a parameter that is not set.
class ParameterReader
{
public:
  /// @param handle of the node's private namespace
  explicit ParameterReader(const ros::NodeHandle& handle);
  /// @param name_space without a slash at its end; @param values a struct of them, as the parameter server has it, or
  /// nothing
  ParameterReader(std::string name_space, const XmlRpc::XmlRpcValue& values);

  /// "/node/gate/max_age"
  std::string nameOf(const std::string& key) const { return name_space_ + "/" + key; }

  bool has(const std::string& key) const { return find(key) != nullptr; }

  /// The parameter, or `fallback` if it is not set; roscpp's own param() takes a value of the wrong type for one that
  /// is not set, and rounds 2.5 where a whole number is wanted. A whole number is a number, too.
  /// @param key with the namespaces below the node's own, "gate/max_age"
  /// @tparam Value bool, int, double, std::string, std::vector<double>, std::vector<std::string>, or
  /// XmlRpc::XmlRpcValue, which is of any type and takes all that is in it for read
  /// @throws std::invalid_argument naming the parameter, its value and the expected type
  template <typename Value>
  Value read(const std::string& key, const Value& fallback);

  /// Logs a warning for every parameter in the namespace that has not been read. Call it when all have been.
  void warnOfUnread() const;

private:
  const XmlRpc::XmlRpcValue* find(const std::string& key) const;
  void warnOfUnread(const XmlRpc::XmlRpcValue& values, const std::string& prefix) const;

  std::string name_space_;
  XmlRpc::XmlRpcValue values_;
  std::set<std::string> read_;  ///< keys
};
}  // namespace xray_tracking
