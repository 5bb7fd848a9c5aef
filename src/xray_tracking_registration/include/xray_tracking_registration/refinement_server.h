#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include <actionlib/server/action_server.h>
#include <ros/ros.h>

#include <xray_tracking_msgs/RefinePose.h>
#include <xray_tracking_msgs/RefinePoseAction.h>

#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Service and action `refine_pose`: one request at a time is worked on, a service's in the thread that it came in, an
/// action's in one for it; others are told at once that it is busy.
class RefinementServer
{
public:
  using Request = xray_tracking_msgs::RefinementRequest;
  using Result = xray_tracking_msgs::RefinementResult;
  /// Tells an action's client how far a registration is. @return false: it is to be broken off
  using Progress = std::function<bool(const RegistrationProgress&)>;
  /// Works on a request. @param arrival of the request
  using Work = std::function<Result(const Request& request, const Progress& progress, const ros::SteadyTime& arrival)>;

  /// @param pnh services and action are below it, in its callback queue
  /// @param work called by one thread at a time
  /// @param broken_off told that brokenOff() has become true
  RefinementServer(const ros::NodeHandle& pnh, Work work, std::function<void()> broken_off);
  ~RefinementServer() { stop(); }
  RefinementServer(const RefinementServer&) = delete;
  RefinementServer& operator=(const RefinementServer&) = delete;

  /// Breaks off what is under way and refuses all else from here on.
  void stop();

  bool stopped() const { return stop_; }
  /// The request under way is not to be worked on any longer.
  bool brokenOff() const { return stop_ || cancel_; }
  bool busy() const;

private:
  using ActionServer = actionlib::ActionServer<xray_tracking_msgs::RefinePoseAction>;
  using GoalHandle = ActionServer::GoalHandle;

  bool refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                    xray_tracking_msgs::RefinePose::Response& response);
  void goalCb(GoalHandle goal);
  void cancelCb(const GoalHandle& goal);
  void workOnGoals();
  /// Takes the place of the one request; @return false if there is one already
  bool claim();
  /// Works on the request of who has claimed it, and makes room for the next one.
  /// @param goal whom to tell of the progress; null: nobody
  Result serve(const Request& request, GoalHandle* goal, const ros::SteadyTime& arrival);
  Result busyResult() const;

  Work work_;
  std::function<void()> on_broken_off_;
  std::atomic<bool> stop_{ false };
  std::atomic<bool> cancel_{ false };
  mutable std::mutex mutex_;  ///< of all to goal_arrival_
  std::condition_variable wake_;
  bool busy_ = false;               ///< a request is being worked on
  std::optional<GoalHandle> goal_;  ///< the action's, if it is one
  ros::SteadyTime goal_arrival_;
  ros::ServiceServer service_;
  ActionServer action_server_;
  std::thread worker_;
};
}  // namespace xray_tracking
