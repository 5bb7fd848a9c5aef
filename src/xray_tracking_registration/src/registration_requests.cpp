// What RegistrationRos does for those who ask: services, action, diagnostics.
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

bool RegistrationRos::claim(Job job)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (job_ || stop_)
    {
      return false;
    }
    if (job.goal)
    {
      job.goal->setAccepted();
    }
    job_ = std::move(job);
  }
  wake_.notify_all();
  return true;
}

bool RegistrationRos::refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                                   xray_tracking_msgs::RefinePose::Response& response)
{
  std::promise<RefinementResult> promise;
  Job job;
  job.request = std::move(request.request);
  job.answer = [&promise](const RefinementResult& result) { promise.set_value(result); };
  response.result = claim(std::move(job)) ? promise.get_future().get() : busyResult();
  return true;
}

void RegistrationRos::goalCb(GoalHandle goal)
{
  Job job;
  job.request = goal.getGoal()->request;
  job.goal = goal;
  job.answer = [goal](const RefinementResult& result) mutable
  {
    xray_tracking_msgs::RefinePoseResult message;
    message.result = result;
    switch (result.status)
    {
      case RefinementResult::SUCCESS:
        goal.setSucceeded(message, result.reason);
        break;
      case RefinementResult::CANCELLED:
        goal.setCanceled(message, result.reason);
        break;
      default:
        goal.setAborted(message, result.reason);
        break;
    }
  };
  if (!claim(std::move(job)))
  {
    xray_tracking_msgs::RefinePoseResult message;
    message.result = busyResult();
    goal.setRejected(message, message.result.reason);
  }
}

void RegistrationRos::cancelCb(GoalHandle goal)
{
  std::function<void(const RefinementResult&)> answer;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!job_ || !job_->goal || *job_->goal != goal)
    {
      return;
    }
    if (job_->running)
    {
      cancel_ = true;
      wake_.notify_all();
      return;
    }
    answer = std::exchange(job_, std::nullopt)->answer;
  }
  answer(resultMessage(RefinementResult::CANCELLED, "cancelled before it began"));
}

RegistrationRos::RefinementResult RegistrationRos::busyResult() const
{
  return resultMessage(RefinementResult::BUSY, stop_ ? "the node is shutting down" : "another request is under way");
}

void RegistrationRos::answerJob()
{
  // Nobody else touches a job that is running.
  const ProcessorClock clock;
  const ros::Time stamp = job_->request.stamp;
  const bool kept = job_->request.images.empty() && !stamp.isZero();
  ros::SteadyTime last_feedback;
  const RefinementResult result = refineRequest(job_->request,
                                                [this, &last_feedback](const RegistrationProgress& progress)
                                                {
                                                  if (stop_ || cancel_)
                                                  {
                                                    return false;
                                                  }
                                                  const ros::SteadyTime now = ros::SteadyTime::now();
                                                  if (job_->goal && (now - last_feedback).toSec() >= kFeedbackPeriod)
                                                  {
                                                    last_feedback = now;
                                                    xray_tracking_msgs::RefinePoseFeedback feedback;
                                                    feedback.level = progress.level;
                                                    feedback.iteration = progress.iteration;
                                                    feedback.similarity = progress.similarity;
                                                    feedback.pose = poseMsgFromRigid(progress.room_from_patient);
                                                    job_->goal->publishFeedback(feedback);
                                                  }
                                                  return true;
                                                });
  // Each exposure once, whoever asks.
  if (parameters_.method == RefinementMethod::TRACKING_AND_REGISTRATION && kept && stamp > last_refined_ && !stop_)
  {
    publishRefined(stamp, result, clock.seconds(), job_->arrival);
  }
  std::function<void(const RefinementResult&)> answer;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    last_result_ = result;
    // Before the answer: who has it may ask again.
    answer = std::exchange(job_, std::nullopt)->answer;
  }
  answer(result);
}

RegistrationRos::RefinementResult RegistrationRos::refineRequest(const RefinementRequest& message,
                                                                 const Progress& progress)
{
  const std::shared_ptr<const Registration> registration = currentRegistration();
  if (!registration)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return resultMessage(RefinementResult::NO_VOLUME, volume_state_);
  }
  StoredExposure exposure;
  try
  {
    if (!message.images.empty())
    {
      exposure = exposureOf(message, setup_);
    }
    else if (const std::string reason = findExposure(message.stamp, exposure); !reason.empty())
    {
      return resultMessage(stop_ || cancel_ ? RefinementResult::CANCELLED : RefinementResult::NO_EXPOSURE, reason);
    }
    // Images that are brought along have nothing to do with what the detectors send.
    UsablePixels own;
    const bool kept = message.images.empty();
    RegistrationRequest request = requestFor(exposure, searchOf(message), kept ? usable_pixels_ : own, progress);
    applyRequest(message, request);
    return run(*registration, request,
               kept ? std::optional<ros::Time>(exposure.images.front()->header.stamp) : std::nullopt,
               message.unverified != 0);
  }
  catch (const std::exception& error)
  {
    return resultMessage(RefinementResult::INVALID, error.what());
  }
}

std::string RegistrationRos::findExposure(const ros::Time& stamp, StoredExposure& exposure)
{
  std::unique_lock<std::mutex> lock(mutex_);
  const StoredExposure* stored = nullptr;
  const auto complete = [&]
  {
    stored = store_ ? store_->find(stamp) : nullptr;
    return stored != nullptr && store_->missingView(*stored).empty();
  };
  if (wake_.wait_for(lock, kArrivalTime, [&] { return stop_ || cancel_ || complete(); }) && complete())
  {
    noteRestart();
    exposure = *stored;
    return std::string();
  }
  std::ostringstream reason;
  if (stored != nullptr)
  {
    reason << "the exposure at " << stamp << " lacks a view: " << store_->missingView(*stored);
  }
  else if (stamp.isZero())
  {
    reason << "there is no exposure with all views so far";
  }
  else
  {
    reason << "there is no exposure at " << stamp << " among the " << (store_ ? store_->size() : 0) << " that are kept";
  }
  return reason.str();
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
    status.summary(DiagnosticStatus::OK, job_ ? "at work on a request" : "ready");
  }
  status.add("method", methodName(parameters_.method));
  status.add("volume", volume_state_);
  status.add("memory of the volume [MB]", registration_ ? registration_->memory() / 1000000 : 0);
  status.add("exposures kept", store_ ? store_->size() : 0);
  if (parameters_.method == RefinementMethod::REGISTRATION)
  {
    status.add("exposures that wait", store_ ? store_->waiting() : 0);
  }
  if (parameters_.method != RefinementMethod::TRACKING)
  {
    status.add("exposures answered", exposures_);
    status.add("exposures refined", refined_);
  }
  if (last_result_)
  {
    status.add("similarity of the last refinement", last_result_->similarity_after);
    status.add("time of the last refinement [s]", last_result_->time.toSec());
  }
}
}  // namespace xray_tracking
