#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include <actionlib/client/simple_action_client.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <xray_tracking_msgs/AlignPatientAction.h>

#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// All that the manual alignment has to do with ROS, its callbacks in a thread of their own; no method waits.
class AlignmentLink
{
public:
  struct Answer
  {
    bool success = false;
    std::string message;
    RigidTransform registered = RigidTransform::Identity();  ///< room_from_patient, of a success
  };

  explicit AlignmentLink(const ros::NodeHandle& nh);
  ~AlignmentLink();

  AlignmentLink(const AlignmentLink&) = delete;
  AlignmentLink& operator=(const AlignmentLink&) = delete;

  /// The pose on patient_pose, if one came lately.
  std::optional<RigidTransform> patientPose() const;
  /// Whether there is somebody who can be asked.
  bool offered();

  /// On alignment_pose, for those who show it.
  void show(const RigidTransform& room_from_patient);
  /// Asks motion estimation to take the patient to be there.
  void state(const RigidTransform& room_from_patient);
  void withdraw();
  bool asked() const;
  /// What came of it, once.
  std::optional<Answer> takeAnswer();

private:
  using Client = actionlib::SimpleActionClient<xray_tracking_msgs::AlignPatientAction>;

  void poseCb(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message);
  void doneCb(std::uint64_t request, const actionlib::SimpleClientGoalState& state,
              const xray_tracking_msgs::AlignPatientResultConstPtr& result);

  ros::NodeHandle nh_;
  ros::CallbackQueue queue_;
  mutable std::mutex mutex_;  ///< of all that follows, but for what is said
  std::optional<RigidTransform> pose_;
  ros::SteadyTime pose_arrival_;
  std::uint64_t request_ = 0;  ///< counts them, and what was withdrawn
  bool asked_ = false;
  std::optional<Answer> answer_;

  ros::Subscriber pose_subscriber_;
  ros::Publisher pose_publisher_;
  std::unique_ptr<Client> client_;  ///< none before there is time: it would wait for that
  std::unique_ptr<ros::AsyncSpinner> spinner_;
};
}  // namespace xray_tracking
