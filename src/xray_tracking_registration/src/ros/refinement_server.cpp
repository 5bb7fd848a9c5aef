#include "xray_tracking_registration/refinement_server.h"

#include <string>
#include <utility>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_registration/refinement_messages.h"

namespace xray_tracking
{
namespace
{
constexpr double kFeedbackPeriod = 0.03;  // [s]
}  // namespace

RefinementServer::RefinementServer(const ros::NodeHandle& pnh, Work work, std::function<void()> broken_off)
  : work_(std::move(work)),
    on_broken_off_(std::move(broken_off)),
    action_server_(
        pnh, "refine_pose", [this](const GoalHandle& goal) { goalCb(goal); },
        [this](const GoalHandle& goal) { cancelCb(goal); }, false)
{
  service_ = ros::NodeHandle(pnh).advertiseService("refine_pose", &RefinementServer::refinePoseCb, this);
  action_server_.start();
  worker_ = std::thread([this] { workOnGoals(); });
}

void RefinementServer::stop()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  on_broken_off_();
  if (worker_.joinable())
  {
    worker_.join();
  }
}

bool RefinementServer::busy() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return busy_;
}

bool RefinementServer::claim()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (busy_ || stop_)
  {
    return false;
  }
  cancel_ = false;
  return busy_ = true;
}

RefinementServer::Result RefinementServer::busyResult() const
{
  return resultMessage(Result::BUSY, stop_ ? "the node is shutting down" : "another request is under way");
}

bool RefinementServer::refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                                    xray_tracking_msgs::RefinePose::Response& response)
{
  const ros::SteadyTime arrival = ros::SteadyTime::now();
  response.result = claim() ? serve(request.request, nullptr, arrival) : busyResult();
  return true;
}

void RefinementServer::goalCb(GoalHandle goal)
{
  if (!claim())
  {
    xray_tracking_msgs::RefinePoseResult message;
    message.result = busyResult();
    goal.setRejected(message, message.result.reason);
    return;
  }
  goal.setAccepted();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    goal_ = goal;
    goal_arrival_ = ros::SteadyTime::now();
  }
  wake_.notify_all();
}

void RefinementServer::cancelCb(const GoalHandle& goal)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!goal_ || *goal_ != goal)
    {
      return;
    }
    cancel_ = true;
  }
  on_broken_off_();
}

void RefinementServer::workOnGoals()
{
  std::unique_lock<std::mutex> lock(mutex_);
  while (true)
  {
    wake_.wait(lock, [this] { return stop_ || goal_; });
    if (!goal_)
    {
      return;
    }
    GoalHandle goal = *goal_;
    const ros::SteadyTime arrival = goal_arrival_;
    lock.unlock();
    xray_tracking_msgs::RefinePoseResult message;
    message.result = serve(goal.getGoal()->request, &goal, arrival);
    switch (message.result.status)
    {
      case Result::SUCCESS:
        goal.setSucceeded(message, message.result.reason);
        break;
      case Result::CANCELLED:
        goal.setCanceled(message, message.result.reason);
        break;
      default:
        goal.setAborted(message, message.result.reason);
        break;
    }
    lock.lock();
  }
}

RefinementServer::Result RefinementServer::serve(const Request& request, GoalHandle* goal,
                                                 const ros::SteadyTime& arrival)
{
  ros::SteadyTime last_feedback;
  const Progress progress = [&](const RegistrationProgress& so_far)
  {
    if (brokenOff())
    {
      return false;
    }
    if (goal != nullptr && (ros::SteadyTime::now() - last_feedback).toSec() >= kFeedbackPeriod)
    {
      last_feedback = ros::SteadyTime::now();
      xray_tracking_msgs::RefinePoseFeedback feedback;
      feedback.level = so_far.level;
      feedback.iteration = so_far.iteration;
      feedback.similarity = so_far.similarity;
      feedback.pose = poseMsgFromRigid(so_far.room_from_patient);
      goal->publishFeedback(feedback);
    }
    return true;
  };
  Result result = work_(request, progress, arrival);
  const std::lock_guard<std::mutex> lock(mutex_);
  // Before the answer: who has it may ask again.
  busy_ = false;
  goal_.reset();
  return result;
}
}  // namespace xray_tracking
