// What MotionEstimationRos does with the registration: asks by the policy, and moves what it knows by the answers.
#include <algorithm>
#include <stdexcept>
#include <utility>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

constexpr double kPeriod = 0.02;  // s, of looking whether an answer has come

/// Exposures that a refinement may be about; what was asked about an older one moves the poses only.
constexpr std::size_t kTracksCapacity = 200;
}  // namespace

void MotionEstimationRos::startRefinement()
{
  refinement_client_.emplace(nh_, parameters_.refinement.timeout);
  refinement_.emplace(parameters_.refinement, setup_.targetCentre(),
                      [this](const RefinementRequest& request)
                      { return refinement_client_->request(request, !gate_->gate().verification().verified()); });
  if (parameters_.refinement.mode != RefinementMode::NEVER)
  {
    tracked_views_.set_capacity(kTracksCapacity);
    refine_server_ = pnh_.advertiseService("refine", &MotionEstimationRos::refineCb, this);
    refinement_timer_ = nh_.createSteadyTimer(ros::WallDuration(kPeriod), &MotionEstimationRos::refinementCb, this);
  }
}

bool MotionEstimationRos::refineCb(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response)
{
  response.success = static_cast<std::uint8_t>(refinement_->demand());
  response.message = "the next exposure will be refined";
  return true;
}

void MotionEstimationRos::refinementCb(const ros::SteadyTimerEvent&)
{
  const std::int64_t now = steadyNanoseconds();
  if (refinement_->tick(now))
  {
    const std::string why = "no answer within " + std::to_string(parameters_.refinement.timeout) + " s";
    ROS_WARN_STREAM("refinement: " << why);
    gate_->refused(why, false);
  }
  if (!refinement_->pending())
  {
    refinement_client_->cancel();
  }
  const std::optional<RefinementReply> reply = refinement_client_->takeReply();
  if (!reply)
  {
    return;
  }
  if (refinement_->pending())  // otherwise an answer to what was given up
  {
    const std::optional<Refinement> refinement = refinement_->onReply(*reply);
    if (refinement)
    {
      accept(*refinement);
    }
    else
    {
      ROS_WARN_STREAM_THROTTLE(1.0, "refinement refused: " << refinement_->lastRefusal());
      gate_->refused(refinement_->lastRefusal(), refinement_->lastRefusalContradicts());
    }
  }
  refinement_->next(now);
}

void MotionEstimationRos::considerRefinement(const PatientMotion& motion, const std::optional<MotionEstimate>& estimate)
{
  if (parameters_.refinement.mode == RefinementMode::NEVER || motion.state == PatientMotion::WAITING)
  {
    return;
  }
  TrackedViews tracked{ assembler_->stamp(), assembler_->exposure(), {} };
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    tracked.offsets.push_back(assembler_->offset(i));
  }
  // What shows nothing, or what an earlier exposure showed, is no evidence of where the patient is.
  const auto is_blind = [](const TrackedRegion::ConstPtr& region)
  { return region && region->state == TrackedRegion::BLIND; };
  if (std::any_of(tracked.regions.begin(), tracked.regions.end(), is_blind))
  {
    return;
  }
  tracked_views_.push_back(std::move(tracked));

  TrackedExposure exposure{ assembler_->stamp(), last_pose_ ? last_pose_->second : reference_, PoseCovariance::Zero(),
                            estimate ? estimate->disagreement_mm : 0.0, motion.state == PatientMotion::OK };
  if (exposure.measured)
  {
    exposure.covariance = estimate->pose_covariance;
  }
  if (gate_->gate().verification().due())
  {
    refinement_->demand();  // whatever the mode
  }
  refinement_->onExposure(exposure, steadyNanoseconds());
}

void MotionEstimationRos::accept(const Refinement& refinement)
{
  const Eigen::Vector3d target = setup_.targetCentre();
  if (history_.empty())
  {
    // Nothing was measured so far: the first templates are still those of the initial pose.
    last_pose_ = { refinement.stamp, refinement.refined };
    return;
  }
  const Matrix6d covariance = covarianceAt(target, refinement.refined, refinement.covariance);
  try
  {
    estimator_->setReference(refinement.refined, covariance);
  }
  catch (const std::invalid_argument& error)
  {
    ROS_WARN_STREAM("refinement refused: " << error.what());
    gate_->refused(error.what(), false);
    return;
  }
  reference_ = refinement.refined;
  reference_covariance_ = covariance;
  consistency_->reset();
  rigid_consistency_->reset();

  Eigen::Vector3d correction = Eigen::Vector3d::Zero();
  if (refinement.tracked)
  {
    const auto carry = [&](const RigidTransform& pose) { return refinement.carry(pose, target); };
    history_.transform(carry);
    for (View& view : views_)
    {
      if (view.reference)
      {
        view.reference->room_from_patient = carry(view.reference->room_from_patient);
      }
    }
    const RigidTransform before = last_pose_->second;
    last_pose_->second = carry(before);
    predictor_->correct(before, last_pose_->second);
    correction = last_pose_->second * target - before * target;
  }
  else
  {
    history_.add(refinement.stamp, refinement.refined);
    if (!last_pose_ || last_pose_->first < refinement.stamp)
    {
      last_pose_ = { refinement.stamp, refinement.refined };
    }
  }
  gate_->refined(refinement.stamp, correction, rotationAngle(last_pose_->second * setup_.room_from_patient.inverse()),
                 refinement.tracked.has_value());

  // From here on tracks count from the refined exposure: what each view was wrong by until then is out of them.
  const auto tracked = std::find_if(tracked_views_.begin(), tracked_views_.end(),
                                    [&](const TrackedViews& views) { return views.stamp == refinement.stamp; });
  for (std::size_t i = 0; tracked != tracked_views_.end() && i < views_.size(); ++i)
  {
    const TrackedRegion::ConstPtr& region = tracked->regions[i];
    std::optional<Reference>& reference = views_[i].reference;
    if (doubtOfState(views_[i], region.get()).state != PatientMotion::OK ||
        (reference && reference->template_stamp > region->reference_stamp))
    {
      continue;
    }
    const Track track = trackOf(i, *region, tracked->offsets[i]);
    if (track.warp().allFinite() && track.covariance.allFinite() && track.linear.determinant() > 0.0)
    {
      reference = Reference{ region->reference_stamp, refinement.refined, track };
    }
  }
  ROS_INFO_STREAM("refinement of the exposure at "
                  << timeFromNanoseconds(refinement.stamp) << " accepted: "
                  << (refinement.tracked
                          ? "the target is " + std::to_string(correction.norm()) + " mm from where the tracks put it"
                          : std::string("it had no pose")));
}
}  // namespace xray_tracking
