#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>

#include <ros/callback_queue.h>
#include <ros/ros.h>

#include "treatment_commands.h"
#include "treatment_feed.h"

namespace xray_tracking
{
/// All that a treatment panel has to do with ROS, in threads of its own; no method waits for another node.
class TreatmentLink
{
public:
  explicit TreatmentLink(const ros::NodeHandle& nh);
  ~TreatmentLink();

  TreatmentView view() const;
  const TreatmentFeed& feed() const { return feed_; }
  TreatmentCommands& commands() { return commands_; }

  /// To be called some times a second by who shows all this, from the thread that takes the operator's input: says by
  /// the heartbeat that the operator can hold the beam. Not while a hold that was asked for has not been confirmed:
  /// motion estimation then holds for the silence.
  /// @param shown whether there is something to hold it by; no heartbeat otherwise
  void beat(bool shown);

private:
  /// Asks the master what there is, again and again.
  void watch();

  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  TreatmentCommands commands_;
  TreatmentFeed feed_;
  ros::Publisher heartbeat_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  std::mutex mutex_;  ///< of the next one
  bool stop_ = false;
  std::condition_variable stopping_;
  std::thread watcher_;
};
}  // namespace xray_tracking
