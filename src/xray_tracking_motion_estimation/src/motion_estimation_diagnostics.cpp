// What MotionEstimationRos tells people: log and diagnostics.
#include <algorithm>

#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

namespace xray_tracking
{
namespace
{
const char* stateName(std::uint8_t state)
{
  static const char* const kNames[] = { "OK", "WAITING", "LOST", "INCONSISTENT", "NO_REFERENCE", "BAD_STAMP" };
  return kNames[state];
}
}  // namespace

void MotionEstimationRos::report(const PatientMotion& motion)
{
  const bool changed = !last_motion_ || last_motion_->state != motion.state;
  last_motion_ = motion;
  if (changed)
  {
    logMotion();
  }
}

void MotionEstimationRos::logMotion()
{
  const PatientMotion& motion = *last_motion_;
  logged_reason_ = motion.reason;
  if (motion.state == PatientMotion::OK)
  {
    ROS_INFO_STREAM("patient's motion: OK from " << motion.header.stamp);
  }
  else
  {
    ROS_WARN_STREAM("patient's motion: " << stateName(motion.state) << " from " << motion.header.stamp << ": "
                                         << motion.reason);
  }
}

void MotionEstimationRos::timerCb(const ros::SteadyTimerEvent&)
{
  const ros::SteadyTime now = ros::SteadyTime::now();
  const auto quiet = [&](const View& view)
  { return (now - std::max(view.last_arrival, first_arrival_)).toSec() > parameters_.view_timeout; };
  const bool any_arrives = !first_arrival_.isZero() && !std::all_of(views_.begin(), views_.end(), quiet);
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    View& view = views_[i];
    const bool silent = any_arrives && quiet(view);
    if (silent && !view.silent)
    {
      ROS_WARN_STREAM("nothing arrives on " << view.tracked_region_subscriber.getTopic()
                                            << " while other detectors send: "
                                            << (views_.size() > 2 ? "it is not waited for" : "no pose until it does"));
    }
    setSilent(i, silent);
    if (view.camera_info.fault() != view.logged_fault)
    {
      view.logged_fault = view.camera_info.fault();
      ROS_ERROR_STREAM_COND(!view.logged_fault.empty(), "no pose: " << view.name << ": " << view.logged_fault);
    }
    if (last_motion_ && last_motion_->state == PatientMotion::OK && view.doubt.reason != view.logged_doubt)
    {
      view.logged_doubt = view.doubt.reason;
      ROS_WARN_STREAM_COND(!view.logged_doubt.empty(), "poses from the other views: " << view.logged_doubt);
    }
  }
  // What is waited for changes within that state. Other reasons have numbers that differ from exposure to exposure.
  if (last_motion_ && last_motion_->state == PatientMotion::WAITING && last_motion_->reason != logged_reason_)
  {
    logMotion();
  }
  if (assembler_)
  {
    const std::size_t drops = assembler_->incomplete() + assembler_->duplicates() + assembler_->late();
    ROS_WARN_STREAM_COND(drops != drops_at_last_warning_,
                         "dropped so far: " << assembler_->incomplete() << " exposures that lack a view, "
                                            << assembler_->duplicates() << " duplicates, " << assembler_->late()
                                            << " late messages");
    drops_at_last_warning_ = drops;
  }
  updater_.force_update();
}

void MotionEstimationRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using diagnostic_msgs::DiagnosticStatus;
  if (!configuration_fault_.empty())
  {
    status.summary(DiagnosticStatus::ERROR, configuration_fault_);
    return;
  }
  if (!last_motion_)
  {
    status.summary(DiagnosticStatus::WARN, "no exposure so far");
  }
  else if (last_motion_->state == PatientMotion::OK)
  {
    status.summary(DiagnosticStatus::OK, "OK");
  }
  else
  {
    const bool waiting = last_motion_->state == PatientMotion::WAITING;
    status.summary(waiting ? DiagnosticStatus::WARN : DiagnosticStatus::ERROR,
                   std::string(stateName(last_motion_->state)) + ": " + last_motion_->reason);
  }
  if (last_motion_ && last_motion_->state == PatientMotion::OK && last_motion_->views_differ)
  {
    status.mergeSummary(DiagnosticStatus::WARN,
                        "the views differ by more than those of a rigid target: surroundings "
                        "that move otherwise, rotation or a fault");
  }
  for (const View& view : views_)
  {
    if (view.silent)
    {
      status.mergeSummary(DiagnosticStatus::WARN, view.name + " is silent");
    }
    if (last_motion_ && last_motion_->state == PatientMotion::OK && view.doubt.state != PatientMotion::OK)
    {
      status.mergeSummary(DiagnosticStatus::WARN, view.doubt.reason);
    }
    if (!view.camera_info.fault().empty())
    {
      status.mergeSummary(DiagnosticStatus::ERROR, view.name + ": " + view.camera_info.fault());
    }
  }

  const ros::SteadyTime now = ros::SteadyTime::now();
  const double elapsed = (now - last_diagnosis_).toSec();
  status.add("rate [Hz]", static_cast<double>(exposures_ - exposures_at_last_diagnosis_) / elapsed);
  last_diagnosis_ = now;
  exposures_at_last_diagnosis_ = exposures_;
  status.add("exposures", exposures_);
  status.add("poses", poses_);
  status.add("exposures whose views differed", differing_);
  status.add("exposures waiting for a view", assembler_->pending());
  status.add("exposures dropped, a view missing", assembler_->incomplete());
  status.add("duplicates dropped", assembler_->duplicates());
  status.add("late messages dropped", assembler_->late());
  status.add("exposures refused, stamped in the future", assembler_->future());
  status.add("observability", observability_);
  status.add("beam gate", std::string(gateReasonName(gate_->gate().reason())) + ": " + gate_->gate().text());
  status.add("refinements asked for", refinement_->requests());
  status.add("refinements accepted", refinement_->accepted());
  status.add("refinements refused", refinement_->refused());
  status.add("refinements without an answer", refinement_->timeouts());
  status.add("refinements not asked for, one under way", refinement_->unheard());
  status.add("refinements skipped for later exposures", refinement_->skipped());
  status.add("last refusal", refinement_->lastRefusal());
  if (last_motion_)
  {
    status.add("since the last exposure [s]", (now - last_exposure_).toSec());
    status.add("state", stateName(last_motion_->state));
    status.add("disagreement [px]", last_motion_->disagreement);
    status.add("chi-square", last_motion_->chi_square);
    status.add("views used", last_motion_->views);
    status.add("processor time of the exposure [s]", last_motion_->cpu_time.toSec());
    status.add("wall time of the exposure [s]", last_motion_->wall_time.toSec());
  }
}
}  // namespace xray_tracking
