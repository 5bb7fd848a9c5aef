#include "alignment_link.h"

#include <exception>
#include <utility>

#include <geometry_msgs/PoseStamped.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::AlignPatientGoal;
using xray_tracking_msgs::AlignPatientResultConstPtr;

constexpr double kPoseLife = 5.0;  ///< after which the patient is nobody knows where [s]
}  // namespace

AlignmentLink::AlignmentLink(const ros::NodeHandle& nh) : nh_(nh)
{
  nh_.setCallbackQueue(&queue_);
  pose_subscriber_ = nh_.subscribe("patient_pose", 1, &AlignmentLink::poseCb, this);
  pose_publisher_ = nh_.advertise<geometry_msgs::PoseStamped>("alignment_pose", 1);
  spinner_ = std::make_unique<ros::AsyncSpinner>(1, &queue_);
  spinner_->start();
}

AlignmentLink::~AlignmentLink()
{
  withdraw();
  pose_subscriber_.shutdown();
  spinner_->stop();
}

void AlignmentLink::poseCb(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message)
{
  std::optional<RigidTransform> pose;
  try
  {
    pose = rigidFromPoseMsg(message->pose.pose);
  }
  catch (const std::exception&)  // of numbers that are no pose
  {
    return;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  pose_ = pose;
  pose_arrival_ = ros::SteadyTime::now();
}

bool AlignmentLink::offered()
{
  if (!client_ && ros::Time::isValid())
  {
    client_ = std::make_unique<Client>(nh_, "motion_estimation/align", false);
  }
  return client_ && client_->isServerConnected();
}

std::optional<RigidTransform> AlignmentLink::patientPose() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return pose_ && (ros::SteadyTime::now() - pose_arrival_).toSec() < kPoseLife ? pose_ : std::nullopt;
}

void AlignmentLink::show(const RigidTransform& room_from_patient)
{
  geometry_msgs::PoseStamped message;
  message.header.stamp = ros::Time::now();
  message.header.frame_id = kRoomFrame;
  message.pose = poseMsgFromRigid(room_from_patient);
  pose_publisher_.publish(message);
}

void AlignmentLink::state(const RigidTransform& room_from_patient)
{
  AlignPatientGoal goal;
  goal.pose.header.stamp = ros::Time::now();
  goal.pose.header.frame_id = kRoomFrame;
  goal.pose.pose = poseMsgFromRigid(room_from_patient);
  if (!offered())
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    answer_ = Answer{ false, "motion_estimation is not running", RigidTransform::Identity() };
    return;
  }
  std::uint64_t request = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    request = ++request_;
    asked_ = true;
    answer_.reset();
  }
  client_->sendGoal(
      goal, [this, request](const actionlib::SimpleClientGoalState& state, const AlignPatientResultConstPtr& result)
      { doneCb(request, state, result); });
}

void AlignmentLink::withdraw()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++request_;
    answer_.reset();
    if (!std::exchange(asked_, false))
    {
      return;
    }
  }
  client_->cancelGoal();
}

bool AlignmentLink::asked() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return asked_;
}

std::optional<AlignmentLink::Answer> AlignmentLink::takeAnswer()
{
  const bool gone = !offered();
  const std::lock_guard<std::mutex> lock(mutex_);
  if (asked_ && gone)
  {
    ++request_;
    asked_ = false;
    return Answer{ false, "motion_estimation is gone", {} };
  }
  return std::exchange(answer_, std::nullopt);
}

void AlignmentLink::doneCb(std::uint64_t request, const actionlib::SimpleClientGoalState& state,
                           const AlignPatientResultConstPtr& result)
{
  Answer answer{ false, "no result: " + state.getText(), RigidTransform::Identity() };
  try
  {
    if (result)
    {
      answer.success = result->success != 0U;
      answer.message = result->message;
      answer.registered = answer.success ? rigidFromPoseMsg(result->registered.pose) : RigidTransform::Identity();
    }
  }
  catch (const std::exception& error)
  {
    answer = { false, error.what(), RigidTransform::Identity() };
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (request == request_)
  {
    asked_ = false;
    answer_ = answer;
  }
}
}  // namespace xray_tracking
