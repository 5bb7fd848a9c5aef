#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <tf2_ros/buffer.h>

#include <xray_tracking_msgs/RenderViews.h>

#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Service `render`: the CT as detectors would see it, for people to look at. A thread of its own and of the lowest
/// priority, which renders without any other's help, so that registrations are not slowed; one request at a time,
/// others wait.
class RenderServer
{
public:
  /// The CT in use. @param why out: why there is none
  using Current = std::function<std::shared_ptr<const Registration>(std::string& why)>;

  /// @param pnh the service is below it; @param tf_buffer outlives this
  RenderServer(const ros::NodeHandle& pnh, const tf2_ros::Buffer& tf_buffer, Current current);
  ~RenderServer();
  RenderServer(const RenderServer&) = delete;
  RenderServer& operator=(const RenderServer&) = delete;

private:
  bool renderCb(xray_tracking_msgs::RenderViews::Request& request, xray_tracking_msgs::RenderViews::Response& response);
  void work();

  ros::CallbackQueue queue_;
  ros::NodeHandle pnh_;
  const tf2_ros::Buffer& tf_buffer_;
  Current current_;
  ros::ServiceServer service_;
  std::atomic<bool> stop_{ false };
  std::thread thread_;  ///< last: it uses all the others
};
}  // namespace xray_tracking
