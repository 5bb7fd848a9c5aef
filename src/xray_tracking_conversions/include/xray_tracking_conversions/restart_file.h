#pragma once

#include <optional>
#include <string>

#include <ros/node_handle.h>

namespace xray_tracking
{
/// What a node keeps on disk for the one that takes its place if it is killed: one file,
/// $ROS_HOME/xray_tracking/restart/<node> (by default in ~/.ros), for its user's eyes alone. A node that ends in order
/// removes it, so that only one that had no time to is succeeded.
///
/// What is in it counts only within the run of the ROS master that it was written in (its run_id): another run may be
/// another patient's. A file that is cut off or altered is found by its length and its CRC-32.
class RestartFile
{
public:
  /// @param pnh of the node's private namespace
  /// @param content what is kept and the version of its form, e.g. "motion 1"
  /// @throws std::runtime_error without a run_id of the master, or where there is neither ROS_HOME nor HOME
  RestartFile(const ros::NodeHandle& pnh, const std::string& content);

  /// @param run the master's; as the other constructor otherwise
  RestartFile(std::string path, std::string content, std::string run);

  /// What a node of this name left behind in this run. @return nothing if there is no file, or it is of another run
  /// @throws std::runtime_error naming the file, what was found and what was expected, if it cannot be used
  std::optional<std::string> read() const;

  /// In the place of what was there, all or nothing. @throws std::runtime_error naming the file and what is wrong
  void write(const std::string& bytes) const;

  /// Nothing happens if there is none.
  void remove() const;

  const std::string& path() const { return path_; }

private:
  std::string path_;
  std::string content_;
  std::string run_;
};
}  // namespace xray_tracking
