#include "xray_tracking_motion_estimation/motion_decision.h"

namespace xray_tracking
{
DecisionRules::DecisionRules(PoseMethod method, const RigidTransform& initial_pose,
                             const Eigen::Vector3d& target_centre)
  : method_(method), initial_pose_(initial_pose), target_centre_(target_centre)
{
}

void DecisionRules::restart(const std::string& doubt)
{
  contradiction_.clear();
  unconfirmed_ = doubt;
}

void DecisionRules::confirm()
{
  contradiction_.clear();
  unconfirmed_.clear();
}

MotionDecision DecisionRules::decide(const TrackedExposure& exposure, const ExposureEstimate& tracks,
                                     const std::optional<Refinement>& refinement,
                                     const std::string& not_registered) const
{
  MotionDecision decision;
  decision.stamp = exposure.stamp;
  decision.cpu_seconds = exposure.cpu_seconds;
  decision.wall_seconds = exposure.wall_seconds;
  decision.state = tracks.state;
  decision.reason = tracks.reason;
  decision.views_differ = tracks.views_differ;
  if (const std::optional<MotionEstimate>& estimate = tracks.estimate)
  {
    decision.room_from_patient = estimate->room_from_patient;
    decision.pose_covariance = estimate->pose_covariance;
    decision.tissue_variance = estimate->tissue_variance;
    decision.displacement_covariance = estimate->covariance.topLeftCorner<3, 3>();
    decision.displacement = displacement(estimate->room_from_patient);
    decision.disagreement = estimate->disagreement;
    decision.chi_square = estimate->chi_square;
    decision.degrees_of_freedom = estimate->degrees_of_freedom;
    decision.views = static_cast<int>(estimate->residuals.size());
  }
  if (refinement)
  {
    decision.state = MotionState::OK;
    decision.reason.clear();
    decision.source = PoseSource::REGISTERED;
    decision.room_from_patient = refinement->refined;
    decision.pose_covariance = refinement->covariance;
    decision.tissue_variance = 0.0;
    decision.displacement_covariance =
        covarianceAt(target_centre_, refinement->refined, refinement->covariance).topLeftCorner<3, 3>();
    decision.displacement = displacement(refinement->refined);
    return decision;
  }
  decision.not_registered = method_ == PoseMethod::TRACKING ? "tracked poses are published" : not_registered;
  if (decision.state != MotionState::OK)
  {
    if (method_ != PoseMethod::TRACKING && decision.reason != decision.not_registered)
    {
      decision.reason += "; not registered: " + decision.not_registered;
    }
  }
  else if (method_ == PoseMethod::REGISTRATION)
  {
    decision.state = MotionState::UNREGISTERED;
    decision.reason = decision.not_registered;
  }
  else if (!contradiction_.empty() && method_ == PoseMethod::TRACKING_AND_REGISTRATION)
  {
    decision.state = MotionState::INCONSISTENT;
    decision.reason = "registration and tracks contradict each other: " + contradiction_;
  }
  else if (!unconfirmed_.empty())
  {
    decision.state = MotionState::NO_REFERENCE;
    decision.reason = unconfirmed_;
  }
  else
  {
    decision.source = PoseSource::TRACKED;
  }
  return decision;
}

Eigen::Vector3d DecisionRules::displacement(const RigidTransform& room_from_patient) const
{
  return room_from_patient * target_centre_ - initial_pose_ * target_centre_;
}

double DecisionRules::rotation(const RigidTransform& room_from_patient) const
{
  return rotationAngle(room_from_patient * initial_pose_.inverse());
}
}  // namespace xray_tracking
