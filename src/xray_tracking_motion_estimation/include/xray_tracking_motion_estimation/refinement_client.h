#pragma once

#include <future>
#include <mutex>
#include <optional>

#include <ros/ros.h>

#include "xray_tracking_motion_estimation/refinement_policy.h"

namespace xray_tracking
{
/// Asks the service `refine_pose` (xray_tracking_msgs/RefinePose) for one refinement at a time, from a thread of its
/// own: a registration may take seconds. All methods return at once and are to be called from one thread.
class RefinementClient
{
public:
  /// @param time_budget that a registration is given [s]
  RefinementClient(const ros::NodeHandle& nh, double time_budget) : nh_(nh), time_budget_(time_budget) {}
  /// Breaks off what is under way.
  ~RefinementClient() { cancel(); }

  /// @return false if an earlier request is still under way
  /// @param unverified nothing has confirmed the pose to start from
  bool request(const RefinementRequest& request, bool unverified);

  /// The answer to the request, once; a failure if there is no such service or it broke off.
  std::optional<RefinementReply> takeReply();

  /// Breaks off the request under way, if there is one: its answer is a failure.
  void cancel();

private:
  RefinementReply call(const RefinementRequest& request, bool unverified);

  ros::NodeHandle nh_;
  double time_budget_;
  std::mutex mutex_;  ///< of the two below
  ros::ServiceClient client_;
  bool cancelled_ = false;
  std::future<RefinementReply> reply_;
};
}  // namespace xray_tracking
