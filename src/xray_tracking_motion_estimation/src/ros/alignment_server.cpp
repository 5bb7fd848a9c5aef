#include "xray_tracking_motion_estimation/alignment_server.h"

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::AlignPatientResult;

/// What is stated is of now: older, the patient may have moved since; ahead, clocks differ [s].
constexpr double kMaxAge = 5.0;

/// @throws std::invalid_argument naming what is wrong
RigidTransform statedPose(const geometry_msgs::PoseStamped& message)
{
  const std::string& frame = message.header.frame_id;
  if (!frame.empty() && frame != kRoomFrame)
  {
    throw std::invalid_argument("the pose's frame is '" + frame + "', expected " + kRoomFrame);
  }
  const double age = (ros::Time::now() - message.header.stamp).toSec();
  if (!message.header.stamp.isZero() && !(std::abs(age) <= kMaxAge))
  {
    std::ostringstream text;
    text.precision(3);
    text << "the pose was stated " << std::abs(age) << " s " << (age > 0.0 ? "ago" : "in the future")
         << ", expected at most " << kMaxAge << " s from now";
    throw std::invalid_argument(text.str());
  }
  return rigidFromPoseMsg(message.pose);
}

AlignPatientResult refused(const std::string& why)
{
  AlignPatientResult result;
  result.message = why;
  return result;
}
}  // namespace

AlignmentServer::AlignmentServer(const ros::NodeHandle& pnh, Claim claim, std::function<void()> withdrawn)
  : claim_(std::move(claim)),
    withdrawn_(std::move(withdrawn)),
    server_(
        pnh, "align", [this](const Server::GoalHandle& goal) { goalCb(goal); },
        [this](const Server::GoalHandle& goal) { cancelCb(goal); }, false)
{
  server_.start();
}

void AlignmentServer::goalCb(Server::GoalHandle goal)
{
  std::string why;
  try
  {
    const RigidTransform room_from_patient = statedPose(goal.getGoal()->pose);
    why = goal_ ? "an earlier statement is still being looked at" : "";
    if (why.empty())
    {
      goal_ = goal;
      goal.setAccepted();
      why = claim_(room_from_patient);
      if (!why.empty())
      {
        goal_.reset();
        goal.setAborted(refused(why), why);
      }
      return;
    }
  }
  catch (const std::exception& error)
  {
    why = error.what();
  }
  goal.setRejected(refused(why), why);
}

void AlignmentServer::cancelCb(Server::GoalHandle goal)
{
  if (!goal_ || *goal_ != goal)
  {
    return;
  }
  goal_.reset();
  withdrawn_();
  goal.setCanceled(refused("withdrawn"), "withdrawn");
}

void AlignmentServer::finish(const ClaimOutcome& outcome)
{
  const std::optional<Server::GoalHandle> goal = std::exchange(goal_, std::nullopt);
  if (!goal)
  {
    return;
  }
  Server::GoalHandle handle = *goal;
  if (!outcome.refusal.empty())
  {
    ROS_WARN_STREAM("a stated pose is not accepted, and everything stays as it was: " << outcome.refusal
                                                                                      << "; lay the overlay over "
                                                                                      << "the images again");
    handle.setAborted(refused(outcome.refusal), outcome.refusal);
    return;
  }
  ROS_WARN_STREAM("somebody has stated where the patient is, and a registration confirms it: motion counts from there");
  AlignPatientResult result;
  result.success = 1U;
  result.message = "registered";
  result.registered.header.stamp = timeFromNanoseconds(outcome.stamp);
  result.registered.header.frame_id = kRoomFrame;
  result.registered.pose = poseMsgFromRigid(outcome.room_from_patient);
  handle.setSucceeded(result, result.message);
}
}  // namespace xray_tracking
