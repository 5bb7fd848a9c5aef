#include "xray_tracking_motion_estimation/exposure_estimator.h"

#include <algorithm>
#include <iomanip>
#include <sstream>
#include <stdexcept>

#include "xray_tracking_motion_estimation/asynchrony.h"
#include "xray_tracking_motion_estimation/observability.h"

namespace xray_tracking
{
namespace
{
/// Distance from the region's centre that stands for its size in the report of what is seen [mm].
constexpr double kRegionExtent = 25.0;

/// Nodes of one launch start within this time [s]: templates that trackers have learnt no earlier before this one's
/// start are their first.
constexpr double kStartUp = 5.0;

/// Whether a view was to have a template, but its exposure did not show the region well enough for one.
bool showsNothing(const TrackedView& view)
{
  return view.state == RegionState::BLIND || (view.state == RegionState::UNTRAINED && !view.fault.empty());
}

double seconds(std::int64_t nanoseconds)
{
  return 1e-9 * static_cast<double>(nanoseconds);
}
}  // namespace

ExposureEstimator::ExposureEstimator(const ExposureEstimatorOptions& options, const RigidTransform& initial_pose,
                                     const Eigen::Vector3d& target_centre)
  : options_(options),
    initial_pose_(initial_pose),
    target_centre_(target_centre),
    reference_(initial_pose),
    last_pose_(initial_pose),
    consistency_(options.consistency),
    rigid_consistency_(options.rigid_consistency),
    references_(options.views.size()),
    doubts_(options.views.size()),
    sights_(options.views.size()),
    measurements_(options.views.size())
{
}

void ExposureEstimator::setGeometry(const std::vector<ProjectionGeometry>& geometries, const TargetShape& shape)
{
  estimator_.emplace(options_.estimation, geometries, target_centre_, shape, reference_);
  estimator_->setReference(reference_, reference_covariance_);
  geometries_ = geometries;
  shape_ = shape;
}

void ExposureEstimator::heardFrom(std::int64_t started, std::int64_t first_exposure)
{
  started_ = started;
  first_heard_ = first_exposure;
}

ExposureEstimate ExposureEstimator::estimate(const TrackedExposure& exposure)
{
  ExposureEstimate result;
  for (std::size_t i = 0; i < doubts_.size(); ++i)
  {
    doubts_[i] = doubtOf(i, exposure);
    if (references_.empty() && !first_unseen_ && exposure.views[i] && showsNothing(*exposure.views[i]))
    {
      first_unseen_ = exposure.stamp + exposure.views[i]->offset;
    }
  }
  if (!enoughViews(result))
  {
    return result;
  }
  result.start_doubt = findReferences(exposure);
  if (!enoughViews(result))
  {
    return result;
  }
  for (std::size_t i = 0; i < doubts_.size(); ++i)
  {
    measurements_[i].reset();
    if (doubts_[i].state == MotionState::OK)
    {
      const TrackedView& view = *exposure.views[i];
      measurements_[i] = references_.measurement(i, trackOf(i, view), exposure.stamp);
      if (observability_.empty())
      {
        const TargetShape shape = shape_->about(target_centre_, reference_.linear());
        observability_ = describe(xray_tracking::observability(geometries_, reference_ * target_centre_, shape,
                                                               view.track.model, kRegionExtent));
      }
    }
  }
  const MotionEstimate& estimate = result.estimate.emplace(estimator_->estimate(measurements_));
  result.reason = estimate.reason;
  if (estimate.status != EstimateStatus::OK && estimate.status != EstimateStatus::INCONSISTENT)
  {
    result.estimate.reset();
    result.state = MotionState::LOST;
    return result;
  }
  result.state = estimate.status == EstimateStatus::OK ? MotionState::OK : MotionState::INCONSISTENT;
  const ConsistencyReport report = consistency_.add(estimate);
  if (result.state == MotionState::OK && !report.consistent)
  {
    result.state = MotionState::INCONSISTENT;
    result.reason = describe(report);
  }
  result.views_differ = !rigid_consistency_.add(estimate).consistent;
  return result;
}

void ExposureEstimator::add(const TrackedExposure& exposure, const RigidTransform& room_from_patient, bool registered)
{
  references_.add(exposure, room_from_patient, registered);
  last_pose_ = room_from_patient;
}

void ExposureEstimator::accept(const Refinement& refinement, const TrackedExposure& exposure)
{
  const Matrix6d covariance = covarianceAt(target_centre_, refinement.refined, refinement.covariance);
  estimator_->setReference(refinement.refined, covariance);
  reference_ = refinement.refined;
  reference_covariance_ = covariance;
  consistency_.reset();
  rigid_consistency_.reset();
  if (refinement.claimed)
  {
    references_.clear();
  }
  else
  {
    references_.carry(refinement, target_centre_);
  }
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    ViewSight& sight = sights_[i];
    sight.hidden = i < refinement.hidden.size() && refinement.hidden[i];
    // A blind view was not compared.
    if (view && view->state != RegionState::BLIND && !view->region.empty() &&
        sight.template_stamp != view->reference_stamp)
    {
      sight.template_stamp = view->reference_stamp;
      sight.template_hidden = sight.hidden;
    }
    if (doubtOf(i, exposure).state == MotionState::OK)
    {
      references_.anchor(i, *exposure.views[i], trackOf(i, *exposure.views[i]), exposure.stamp, refinement.refined,
                         regionAt(i, refinement.refined));
    }
  }
}

std::string ExposureEstimator::faultOf(const RigidTransform& room_from_patient) const
{
  try
  {
    MotionEstimator(*estimator_).setReference(room_from_patient, reference_covariance_);
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  return std::string();
}

void ExposureEstimator::restart()
{
  references_.clear();
  reference_ = last_pose_ = initial_pose_;
  reference_covariance_.setZero();
  if (estimator_)
  {
    estimator_->setReference(reference_, reference_covariance_);
  }
  consistency_.reset();
  rigid_consistency_.reset();
  doubts_.assign(doubts_.size(), {});
  for (ViewSight& sight : sights_)
  {
    sight.hidden = false;  // what was learnt stays what it is
  }
  first_unseen_.reset();
}

std::optional<MotionMemory> ExposureEstimator::memory() const
{
  if (references_.empty())
  {
    return std::nullopt;
  }
  MotionMemory memory;
  memory.references = references_.references();
  memory.sights = sights_;
  memory.reference = reference_;
  memory.reference_covariance = reference_covariance_;
  return memory;
}

void ExposureEstimator::takeUp(const MotionMemory& memory)
{
  for (const std::size_t views : { memory.references.size(), memory.sights.size() })
  {
    if (views != options_.views.size())
    {
      throw std::invalid_argument("what is kept is of " + std::to_string(views) + " views, expected " +
                                  std::to_string(options_.views.size()));
    }
  }
  estimator_->setReference(memory.reference, memory.reference_covariance);
  reference_ = memory.reference;
  reference_covariance_ = memory.reference_covariance;
  last_pose_ = memory.last_pose;
  consistency_.reset();
  rigid_consistency_.reset();
  references_.clear();
  references_.takeUp(memory.references);
  sights_ = memory.sights;
  references_.add(memory.last_stamp, memory.last_pose);
}

std::optional<cv::Rect> ExposureEstimator::regionAt(std::size_t view, const RigidTransform& room_from_patient) const
{
  return references_.regionAt(view, geometries_[view], room_from_patient, target_centre_);
}

ExposureEstimator::Doubt ExposureEstimator::doubtOf(std::size_t view, const TrackedExposure& exposure) const
{
  const std::optional<TrackedView>& tracked = exposure.views[view];
  const std::string& name = options_.views[view];
  if (!tracked)
  {
    return { MotionState::LOST, name + " is silent" };
  }
  // A track of what hides the target is none of it.
  if (sights_[view].hidden)
  {
    return { MotionState::LOST, "something hides the target from " + name };
  }
  if (isSpoilt(view, *tracked))
  {
    return { MotionState::LOST, name + " has learnt its region while something hid the target" };
  }
  const std::string why = tracked->fault.empty() ? std::string() : ": " + tracked->fault;
  switch (tracked->state)
  {
    case RegionState::TRACKING:
    case RegionState::DEGRADED:
      return {};
    case RegionState::UNTRAINED:
      return { MotionState::WAITING, name + " is untrained" + why };
    case RegionState::TRAINING:
      return { MotionState::WAITING, name + " is training" };
    case RegionState::BLIND:
      return { MotionState::LOST, name + " is blind" + why };
    default:
      return { MotionState::LOST, name + " has lost its region" + why };
  }
}

bool ExposureEstimator::enoughViews(ExposureEstimate& estimate) const
{
  const auto usable =
      std::count_if(doubts_.begin(), doubts_.end(), [](const Doubt& doubt) { return doubt.state == MotionState::OK; });
  if (usable >= 2)
  {
    return true;
  }
  // A view that is lost outdoes one without a reference, and that one that only waits.
  const auto rank = [](const Doubt& doubt)
  {
    switch (doubt.state)
    {
      case MotionState::LOST:
        return 3;
      case MotionState::NO_REFERENCE:
        return 2;
      case MotionState::WAITING:
        return 1;
      default:
        return 0;
    }
  };
  const Doubt& worst = *std::max_element(doubts_.begin(), doubts_.end(),
                                         [&](const Doubt& a, const Doubt& b) { return rank(a) < rank(b); });
  estimate.state = worst.state;
  estimate.reason = worst.reason;
  return false;
}

std::string ExposureEstimator::findReferences(const TrackedExposure& exposure)
{
  const bool first = references_.empty();
  std::optional<std::int64_t> first_stamp, last_stamp;
  for (std::size_t i = 0; i < doubts_.size(); ++i)
  {
    if (doubts_[i].state != MotionState::OK)
    {
      continue;
    }
    const std::int64_t stamp = exposure.views[i]->reference_stamp;
    if (first)
    {
      // The patient is taken to have kept its initial pose until the views track.
      references_.add(stamp, reference_);
      first_stamp = std::min(first_stamp.value_or(stamp), stamp);
      last_stamp = std::max(last_stamp.value_or(stamp), stamp);
    }
    if (!references_.find(i, *exposure.views[i]))
    {
      std::ostringstream reason;
      reason << options_.views[i] << " was trained on the exposure at " << std::fixed << std::setprecision(9)
             << seconds(stamp) << ", whose pose is not known";
      doubts_[i] = { MotionState::NO_REFERENCE, reason.str() };
    }
  }
  return first ? judgeStart(*first_stamp, *last_stamp) : std::string();
}

std::string ExposureEstimator::judgeStart(std::int64_t first, std::int64_t last)
{
  const double tolerance = options_.pairing_tolerance;
  const double unseen = first_unseen_ ? seconds(last - *first_unseen_) : 0.0;
  const double apart = seconds(last - first);
  if (const double unknown = std::max(unseen, apart); unknown > tolerance)
  {
    const double moved = options_.target_speed * unknown;
    reference_covariance_.topLeftCorner<3, 3>() = moved * moved * Eigen::Matrix3d::Identity();
    estimator_->setReference(reference_, reference_covariance_);
  }
  std::ostringstream doubt;
  doubt << std::fixed << std::setprecision(3);
  if (unseen > tolerance)
  {
    doubt << "the first exposures, from " << seconds(*first_unseen_) << " s to " << seconds(last)
          << " s, did not show the region, and the patient may have left the initial pose by then";
  }
  else if (apart > kStartUp)
  {
    doubt << "the first templates were learnt at different times, from " << seconds(first) << " s to " << seconds(last)
          << " s, and the patient may have moved from the initial pose meanwhile";
  }
  // Stamps may be of another clock than this node's start: then what was heard tells.
  else if (seconds(first_heard_ - first) > tolerance && seconds(started_ - first) > kStartUp)
  {
    doubt << "the first templates were learnt at " << seconds(first)
          << " s, before the first exposure that was heard of here, at " << seconds(first_heard_)
          << " s, and the patient may have been anywhere";
  }
  return doubt.str();
}

Track ExposureEstimator::trackOf(std::size_t view, const TrackedView& tracked) const
{
  Track track = tracked.track;
  if (tracked.offset != 0)
  {
    track.covariance.topLeftCorner<2, 2>() +=
        asynchronyCovariance(geometries_[view].projectionJacobian(last_pose_ * target_centre_), options_.target_speed,
                             seconds(tracked.offset));
  }
  return track;
}
}  // namespace xray_tracking
