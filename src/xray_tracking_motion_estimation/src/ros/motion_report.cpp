#include "xray_tracking_motion_estimation/motion_report.h"

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
/// What a person can do, where the reason does not say it.
std::string adviceFor(MotionState state)
{
  switch (state)
  {
    case MotionState::LOST:
      return "; if it lasts, look at the images and draw the regions anew";
    case MotionState::INCONSISTENT:
      return "; if it lasts, look at the outlines, and whether a panel has moved";
    case MotionState::NO_REFERENCE:
      return "; wait for a registration, align by hand, or restart with the patient at the initial pose";
    case MotionState::BAD_STAMP:
      return "; set the detectors' and this computer's clocks alike";
    case MotionState::UNREGISTERED:
      return "; if it lasts, look at the registration's diagnostics";
    default:
      return "";
  }
}
}  // namespace

void MotionReport::add(const MotionDecision& decision)
{
  ++exposures_;
  tracked_ += decision.source == PoseSource::TRACKED ? 1 : 0;
  registered_ += decision.source == PoseSource::REGISTERED ? 1 : 0;
  differing_ += decision.views_differ ? 1 : 0;
  last_exposure_ = ros::SteadyTime::now();
  last_ = decision;
  // What is logged is what holds for a second and more: views may come and go with every exposure.
  const std::pair motion(decision.state, decision.source);
  if (logged_motion_ != motion && throttle_.due(motionStateName(motion.first) + std::to_string(int(motion.second))))
  {
    logged_motion_ = motion;
    logMotion();
  }
}

void MotionReport::logMotion()
{
  const MotionDecision& decision = *last_;
  const ros::Time stamp = timeFromNanoseconds(decision.stamp);
  logged_reason_ = decision.reason;
  if (decision.state != MotionState::OK)
  {
    ROS_WARN_STREAM("patient's motion: " << motionStateName(decision.state) << " from " << stamp << ": "
                                         << decision.reason);
  }
  else if (decision.source == PoseSource::REGISTERED)
  {
    ROS_INFO_STREAM("patient's motion: OK, registered, from " << stamp);
  }
  else
  {
    ROS_INFO_STREAM("patient's motion: OK, tracked, from " << stamp << ": " << decision.not_registered);
  }
}

void MotionReport::log(const MotionMonitor& monitor, const std::vector<ViewReport>& views, const AssemblyCounts& counts)
{
  logged_.resize(views.size());
  for (std::size_t i = 0; i < views.size(); ++i)
  {
    const ViewReport& view = views[i];
    Logged& logged = logged_[i];
    if (view.silent != logged.silent)
    {
      logged.silent = view.silent;
      ROS_WARN_STREAM_COND(view.silent, "nothing arrives on "
                                            << view.topic << " while other detectors send: "
                                            << (views.size() > 2 ? "it is not waited for" : "no pose until it does")
                                            << "; look at its detector's driver and tracker");
    }
    if (view.camera_info_fault != logged.fault)
    {
      logged.fault = view.camera_info_fault;
      ROS_ERROR_STREAM_COND(!logged.fault.empty(), "no pose: " << view.name << ": " << logged.fault);
    }
    const std::string& doubt = monitor.tracks().doubt(i).reason;
    if (last_ && last_->state == MotionState::OK && doubt != logged.doubt)
    {
      logged.doubt = doubt;
      ROS_WARN_STREAM_COND(!doubt.empty(), "poses without " << view.name << ": " << doubt);
    }
  }
  // What is waited for changes within that state. Other reasons have numbers that differ from exposure to exposure.
  if (last_ && last_->state == MotionState::WAITING && last_->reason != logged_reason_)
  {
    logMotion();
  }
  const std::size_t drops = counts.incomplete + counts.duplicates + counts.late;
  ROS_WARN_STREAM_COND(drops != drops_at_last_warning_,
                       "dropped so far: " << counts.incomplete << " exposures that lack a view, " << counts.duplicates
                                          << " duplicates, " << counts.late
                                          << " late messages; look whether all detectors stamp alike, and the network "
                                          << "is quick enough");
  drops_at_last_warning_ = drops;
}

void MotionReport::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status, const MotionMonitor& monitor,
                            const std::vector<ViewReport>& views, const AssemblyCounts& counts)
{
  using diagnostic_msgs::DiagnosticStatus;
  const bool ok = last_ && last_->state == MotionState::OK;
  if (!last_)
  {
    status.summary(DiagnosticStatus::WARN,
                   "no exposure so far: do all detectors send, and all trackers answer (tracked_region)?");
  }
  else if (ok)
  {
    status.summary(DiagnosticStatus::OK, "OK");
  }
  else
  {
    status.summary(last_->state == MotionState::WAITING ? DiagnosticStatus::WARN : DiagnosticStatus::ERROR,
                   std::string(motionStateName(last_->state)) + ": " + last_->reason + adviceFor(last_->state));
  }
  if (ok && last_->views_differ)
  {
    status.mergeSummary(DiagnosticStatus::WARN,
                        "the views differ by more than those of a rigid target: surroundings "
                        "that move otherwise, rotation or a fault; look at the outlines, and that no panel has moved");
  }
  for (std::size_t i = 0; i < views.size(); ++i)
  {
    if (views[i].silent)
    {
      status.mergeSummary(DiagnosticStatus::WARN, views[i].name + " is silent: look at its driver and tracker");
    }
    if (ok && monitor.tracks().doubt(i).state != MotionState::OK)
    {
      status.mergeSummary(DiagnosticStatus::WARN, monitor.tracks().doubt(i).reason);
    }
    if (!views[i].camera_info_fault.empty())
    {
      status.mergeSummary(DiagnosticStatus::ERROR, views[i].name + ": " + views[i].camera_info_fault);
    }
  }

  const ros::SteadyTime now = ros::SteadyTime::now();
  const double elapsed = (now - last_diagnosis_).toSec();
  status.add("rate [Hz]", static_cast<double>(exposures_ - exposures_at_last_diagnosis_) / elapsed);
  last_diagnosis_ = now;
  exposures_at_last_diagnosis_ = exposures_;
  status.add("exposures", exposures_);
  status.add("poses", tracked_ + registered_);
  status.add("poses that are registered", registered_);
  status.add("exposures whose views differed", differing_);
  status.add("exposures waiting for a view", counts.pending);
  status.add("exposures dropped, a view missing", counts.incomplete);
  status.add("duplicates dropped", counts.duplicates);
  status.add("late messages dropped", counts.late);
  status.add("exposures refused, stamped in the future", counts.future);
  status.add("observability", monitor.tracks().observability());
  const BeamGate& gate = monitor.gate();
  status.add("beam gate", std::string(gateReasonName(gate.reason())) + ": " + gate.text());
  const RefinementPolicy& refinement = monitor.refinement();
  status.add("refinements asked for", refinement.requests());
  status.add("refinements accepted", refinement.accepted());
  status.add("refinements refused", refinement.refused());
  status.add("refinements without an answer", refinement.timeouts());
  status.add("last refusal", refinement.lastRefusal());
  if (last_)
  {
    status.add("since the last exposure [s]", (now - last_exposure_).toSec());
    status.add("state", motionStateName(last_->state));
    status.add("not registered", last_->not_registered);
    status.add("disagreement [px]", last_->disagreement);
    status.add("chi-square", last_->chi_square);
    status.add("views used", last_->views);
    status.add("processor time of the exposure [s]", last_->cpu_seconds);
    status.add("wall time of the exposure [s]", last_->wall_seconds);
  }
}
}  // namespace xray_tracking
