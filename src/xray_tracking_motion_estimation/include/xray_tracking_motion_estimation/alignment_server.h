#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <actionlib/server/action_server.h>
#include <ros/ros.h>
#include <xray_tracking_msgs/AlignPatientAction.h>

#include "xray_tracking_motion_estimation/motion_monitor.h"

namespace xray_tracking
{
/// The action by which people state where the patient is: one goal at a time. All in the thread of the node's queue.
class AlignmentServer
{
public:
  /// @return why the pose cannot be looked at; empty if it is, whereupon finish() will be called
  using Claim = std::function<std::string(const RigidTransform& room_from_patient)>;

  /// @param withdrawn the pose that was claimed last counts for nothing
  AlignmentServer(const ros::NodeHandle& pnh, Claim claim, std::function<void()> withdrawn);

  void finish(const ClaimOutcome& outcome);

private:
  using Server = actionlib::ActionServer<xray_tracking_msgs::AlignPatientAction>;

  void goalCb(Server::GoalHandle goal);
  void cancelCb(Server::GoalHandle goal);

  Claim claim_;
  std::function<void()> withdrawn_;
  std::optional<Server::GoalHandle> goal_;
  Server server_;  ///< last: its callbacks use the others
};
}  // namespace xray_tracking
