#pragma once

#include <chrono>
#include <string>

#include <ros/node_handle.h>

namespace xray_tracking
{
/// What a node keeps on disk for the one that takes its place when it has died: one file,
/// $ROS_HOME/xray_tracking/restart/<master's host and port>/<node> (by default in ~/.ros), for its user's eyes alone.
///
/// That a node takes the place of another, and is not the first of a launch, is known by a token, a private parameter
/// that the first one sets (clear_params in the launch file ends it with the launch). A file without it is another
/// launch's, and so maybe another patient's. One that is cut off or altered is found by its CRC-32, which is of all of
/// it.
class RestartFile
{
public:
  /// Sets the token if there is none, and removes what another launch has left: of this node and master, and of all of
  /// them what is older than kLife.
  /// @param pnh of the node's private namespace
  /// @param content what is kept and the version of its form, e.g. "motion 1"
  RestartFile(const ros::NodeHandle& pnh, const std::string& content);
  /// @param path of the file; @param token of one line; @param succeeds see succeeds()
  RestartFile(std::string path, std::string content, std::string token, bool succeeds);

  /// Whether a node of this name was there before in this launch, however it ended.
  bool succeeds() const { return succeeds_; }

  /// What that one left behind. @throws std::runtime_error naming the file, what was found and what was expected
  std::string read() const;

  /// In the place of what was there. Where that fails what was there is void, as it is not true any more.
  /// @throws std::runtime_error naming the file and what is wrong
  void write(const std::string& bytes) const;

  /// Nothing happens if there is none.
  void remove() const;

  /// Removes files below a folder that are older than kLife. A folder that is none has none.
  static void removeOld(const std::string& folder);

  const std::string& path() const { return path_; }

  static constexpr const char* kToken = "restart_token";  ///< the parameter's name
  static constexpr std::chrono::hours kLife{ 24 };        ///< no treatment is longer

private:
  void replace(const std::string& bytes) const;

  std::string path_;
  std::string content_;
  std::string token_;
  bool succeeds_;
};
}  // namespace xray_tracking
