// What RegistrationRos does for those who ask: services, action, diagnostics.
#include <algorithm>
#include <chrono>
#include <sstream>
#include <utility>

#include "processor_clock.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_registration/refinement_messages.h"
#include "xray_tracking_registration/registration_ros.h"

namespace xray_tracking
{
namespace
{
constexpr double kFeedbackPeriod = 0.03;  // [s]

/// Who tracks may ask about an exposure before all of its messages are here.
constexpr std::chrono::milliseconds kArrivalTime(500);
}  // namespace

bool RegistrationRos::claim()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (busy_ || stop_)
  {
    return false;
  }
  cancel_ = false;
  return busy_ = true;
}

RegistrationRos::RefinementResult RegistrationRos::busyResult() const
{
  return resultMessage(RefinementResult::BUSY, stop_ ? "the node is shutting down" : "another request is under way");
}

bool RegistrationRos::refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                                   xray_tracking_msgs::RefinePose::Response& response)
{
  const ros::SteadyTime arrival = ros::SteadyTime::now();
  response.result = claim() ? serve(request.request, nullptr, arrival) : busyResult();
  return true;
}

void RegistrationRos::goalCb(GoalHandle goal)
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

void RegistrationRos::cancelCb(GoalHandle goal)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!goal_ || *goal_ != goal)
    {
      return;
    }
    cancel_ = true;
  }
  wake_.notify_all();
}

void RegistrationRos::workOnGoals()
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
      case RefinementResult::SUCCESS:
        goal.setSucceeded(message, message.result.reason);
        break;
      case RefinementResult::CANCELLED:
        goal.setCanceled(message, message.result.reason);
        break;
      default:
        goal.setAborted(message, message.result.reason);
        break;
    }
    lock.lock();
  }
}

RegistrationRos::RefinementResult RegistrationRos::serve(const RefinementRequest& request, GoalHandle* goal,
                                                         const ros::SteadyTime& arrival)
{
  const ProcessorClock clock;
  ros::SteadyTime last_feedback;
  const Progress progress = [&](const RegistrationProgress& so_far)
  {
    if (stop_ || cancel_)
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
  std::int64_t stamp_ns = nanosecondsFromTime(request.stamp);
  RefinementResult result = refine(request, progress, stamp_ns);
  if (request.images.empty() && stamp_ns != 0 && !stop_)
  {
    publishRefined(stamp_ns, result, clock.seconds(), arrival);
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  last_result_ = result;
  // Before the answer: who has it may ask again.
  busy_ = false;
  goal_.reset();
  return result;
}

RegistrationRos::RefinementResult RegistrationRos::refine(const RefinementRequest& message, const Progress& progress,
                                                          std::int64_t& stamp_ns)
{
  std::shared_ptr<const Registration> registration;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!registration_)
    {
      return resultMessage(RefinementResult::NO_VOLUME, volume_state_);
    }
    registration = registration_;
  }
  try
  {
    const bool kept = message.images.empty();
    StoredExposure exposure;
    if (!kept)
    {
      exposure = exposureOf(message, setup_);
    }
    else if (const std::string reason = findExposure(stamp_ns, exposure); !reason.empty())
    {
      return resultMessage(stop_ || cancel_ ? RefinementResult::CANCELLED : RefinementResult::NO_EXPOSURE, reason);
    }
    RegistrationRequest request = requestFor(exposure, searchOf(message), progress);
    applyRequest(message, request);
    sequence_->setRegistration(std::move(registration));
    return resultMessage(sequence_->run(std::move(request), kept ? std::optional<std::int64_t>(stamp_ns) : std::nullopt,
                                        message.unverified != 0),
                         setup_.targetCentre());
  }
  catch (const std::exception& error)
  {
    return resultMessage(RefinementResult::INVALID, error.what());
  }
}

RegistrationRequest RegistrationRos::requestFor(const StoredExposure& exposure, Search search,
                                                const Progress& progress) const
{
  RegistrationRequest request;
  request.views = viewsOf(exposure, setup_, tf_buffer_);
  request.intensity = setup_.intensity;
  const bool wide = search == Search::WIDE;
  request.search = search;
  request.max_translation_mm = wide ? parameters_.search_max_translation_mm : parameters_.max_translation_mm;
  request.max_rotation_rad = wide ? parameters_.search_max_rotation_rad : parameters_.max_rotation_rad;
  request.time_budget = std::chrono::duration<double>(parameters_.time_budget_s);
  request.progress = progress;
  return request;
}

std::string RegistrationRos::findExposure(std::int64_t& stamp_ns, StoredExposure& exposure)
{
  std::unique_lock<std::mutex> lock(mutex_);
  const StoredExposure* stored = nullptr;
  const auto complete = [&]
  {
    stored = store_ ? store_->find(stamp_ns) : nullptr;
    return stored != nullptr && store_->missingView(*stored).empty();
  };
  if (wake_.wait_for(lock, kArrivalTime, [&] { return stop_ || cancel_ || complete(); }) && complete())
  {
    if (run_ != store_->run())
    {
      ROS_WARN_STREAM("exposures start again: forgetting the earlier ones");
      run_ = store_->run();
      sequence_->forget();
      published_.clear();
    }
    exposure = *stored;
    return std::string();
  }
  std::ostringstream reason;
  if (stored != nullptr)
  {
    reason << "the exposure at " << timeFromNanoseconds(stamp_ns) << " lacks a view: " << store_->missingView(*stored);
  }
  else if (stamp_ns == 0)
  {
    reason << "there is no exposure with all views so far";
  }
  else
  {
    reason << "there is no exposure at " << timeFromNanoseconds(stamp_ns) << " among the "
           << (store_ ? store_->size() : 0) << " that are kept";
  }
  return reason.str();
}

void RegistrationRos::publishRefined(std::int64_t stamp_ns, const RefinementResult& result, double cpu_seconds,
                                     const ros::SteadyTime& arrival)
{
  // Each exposure once, whoever asks.
  if (std::find(published_.begin(), published_.end(), stamp_ns) != published_.end())
  {
    return;
  }
  published_.push_back(stamp_ns);
  if (published_.size() > static_cast<std::size_t>(parameters_.queue_size))
  {
    published_.pop_front();
  }
  xray_tracking_msgs::RefinedPose refined;
  refined.header.stamp = timeFromNanoseconds(stamp_ns);
  refined.header.frame_id = kRoomFrame;
  refined.result = result;
  refined.cpu_time = ros::Duration(cpu_seconds);
  refined.wall_time = ros::Duration((ros::SteadyTime::now() - arrival).toSec());
  refined_pose_publisher_.publish(refined);
  const bool success = result.status == RefinementResult::SUCCESS;
  ROS_WARN_STREAM_COND(!success, "the exposure at " << refined.header.stamp << " is not refined: " << result.reason);
  const std::lock_guard<std::mutex> lock(mutex_);
  ++exposures_;
  refined_ += success ? 1 : 0;
}

bool RegistrationRos::loadVolumeCb(xray_tracking_msgs::LoadVolume::Request& request,
                                   xray_tracking_msgs::LoadVolume::Response& response)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!configuration_fault_.empty())
    {
      response.message = "the node is idle: " + configuration_fault_;
    }
    else if (request.path.empty())
    {
      response.message = "path is empty, expected a volume file or a folder with a DICOM series";
    }
    else if (loading_)
    {
      response.message = "busy: another volume is being loaded";
    }
    if (!response.message.empty())
    {
      return true;
    }
    loading_ = true;
  }
  response.message = load(request.path);
  response.success = response.message.empty();
  if (response.success)
  {
    response.message = "loaded";
  }
  return true;
}

void RegistrationRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using diagnostic_msgs::DiagnosticStatus;
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!registration_)
  {
    status.summary(loading_ ? DiagnosticStatus::WARN : DiagnosticStatus::ERROR, volume_state_);
  }
  else if (last_result_ && last_result_->status != RefinementResult::SUCCESS)
  {
    status.summary(DiagnosticStatus::WARN, "the last refinement: " + last_result_->reason);
  }
  else
  {
    status.summary(DiagnosticStatus::OK, busy_ ? "at work on a request" : "ready");
  }
  status.add("volume", volume_state_);
  status.add("memory of the volume [MB]", registration_ ? registration_->memory() / 1000000 : 0);
  status.add("exposures kept", store_ ? store_->size() : 0);
  status.add("exposures answered", exposures_);
  status.add("exposures refined", refined_);
  if (last_result_)
  {
    status.add("similarity of the last refinement", last_result_->similarity_after);
    status.add("time of the last refinement [s]", last_result_->time.toSec());
  }
}
}  // namespace xray_tracking
