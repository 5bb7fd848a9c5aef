// How MotionEstimationRos comes from an exposure's tracked regions to an estimate.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <sstream>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_motion_estimation/asynchrony.h"
#include "xray_tracking_motion_estimation/motion_estimation_ros.h"
#include "xray_tracking_motion_estimation/observability.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

/// Distance from the region's centre that stands for its size in the report of what is seen [mm].
constexpr double kRegionExtent = 25.0;

/// Nodes of one launch start within this time [s]: templates that trackers have learnt no earlier before this one's
/// start are their first.
constexpr double kStartUp = 5.0;

static_assert(static_cast<int>(TrackModel::TRANSLATION) == TrackedRegion::TRANSLATION);
static_assert(static_cast<int>(TrackModel::EUCLIDEAN) == TrackedRegion::EUCLIDEAN);
static_assert(static_cast<int>(TrackModel::SIMILARITY) == TrackedRegion::SIMILARITY);
static_assert(static_cast<int>(TrackModel::AFFINE) == TrackedRegion::AFFINE);

/// Whether a view was to have a template, but its exposure did not show the region well enough for one.
bool showsNothing(const TrackedRegion& region)
{
  return region.state == TrackedRegion::BLIND || (region.state == TrackedRegion::UNTRAINED && !region.fault.empty());
}

bool isModel(std::uint8_t model)
{
  return model == TrackedRegion::TRANSLATION || model == TrackedRegion::EUCLIDEAN ||
         model == TrackedRegion::SIMILARITY || model == TrackedRegion::AFFINE;
}
}  // namespace

std::optional<MotionEstimate> MotionEstimationRos::estimate(PatientMotion& motion)
{
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    views_[i].doubt = doubtOfState(views_[i], assembler_->exposure()[i].get());
    const TrackedRegion* region = assembler_->exposure()[i].get();
    if (history_.empty() && !first_unseen_ && region && showsNothing(*region))
    {
      first_unseen_ = region->header.stamp;
    }
  }
  if (!enoughViews(motion))
  {
    return std::nullopt;
  }
  if (!(motion.reason = checkGeometry()).empty())
  {
    motion.state = PatientMotion::WAITING;
    return std::nullopt;
  }
  findReferences();
  if (!enoughViews(motion))
  {
    return std::nullopt;
  }

  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    measurements_[i].reset();
    if (views_[i].doubt.state == PatientMotion::OK)
    {
      measurements_[i] = measure(i);
    }
  }
  MotionEstimate result = estimator_->estimate(measurements_);
  if (result.status != EstimateStatus::OK && result.status != EstimateStatus::INCONSISTENT)
  {
    motion.state = PatientMotion::LOST;
    motion.reason = result.reason;
    return std::nullopt;
  }
  judgeConsistency(result, motion);
  motion.translation = vectorMsgFromMillimetres(displacement(result.room_from_patient));
  motion.covariance = covarianceMsgFromMillimetres(result.covariance.topLeftCorner<3, 3>());
  motion.disagreement = result.disagreement;
  motion.chi_square = result.chi_square;
  motion.degrees_of_freedom = static_cast<std::uint32_t>(result.degrees_of_freedom);
  motion.views = static_cast<std::uint32_t>(result.residuals.size());
  return result;
}

MotionEstimationRos::Doubt MotionEstimationRos::doubtOfState(const View& view, const TrackedRegion* region) const
{
  if (!region)
  {
    return { PatientMotion::LOST, view.name + " is silent" };
  }
  const std::string why = region->fault.empty() ? std::string() : ": " + region->fault;
  switch (region->state)
  {
    case TrackedRegion::TRACKING:
    case TrackedRegion::DEGRADED:
      return isModel(region->model)
                 ? Doubt()
                 : Doubt{ PatientMotion::LOST, view.name + " has the unknown model " + std::to_string(region->model) };
    case TrackedRegion::UNTRAINED:
      return { PatientMotion::WAITING, view.name + " is untrained" + why };
    case TrackedRegion::TRAINING:
      return { PatientMotion::WAITING, view.name + " is training" };
    case TrackedRegion::LOST:
      return { PatientMotion::LOST, view.name + " has lost its region" + why };
    case TrackedRegion::BLIND:
      return { PatientMotion::LOST, view.name + " is blind" + why };
    default:
      return { PatientMotion::LOST, view.name + " has the unknown state " + std::to_string(region->state) };
  }
}

bool MotionEstimationRos::enoughViews(PatientMotion& motion) const
{
  const auto usable = std::count_if(views_.begin(), views_.end(),
                                    [](const View& view) { return view.doubt.state == PatientMotion::OK; });
  if (usable >= 2)
  {
    return true;
  }
  // A view that is lost outdoes one without a reference, and that one that only waits.
  const auto rank = [](const View& view)
  {
    switch (view.doubt.state)
    {
      case PatientMotion::LOST:
        return 3;
      case PatientMotion::NO_REFERENCE:
        return 2;
      case PatientMotion::WAITING:
        return 1;
      default:
        return 0;
    }
  };
  const View& worst =
      *std::max_element(views_.begin(), views_.end(), [&](const View& a, const View& b) { return rank(a) < rank(b); });
  motion.state = worst.doubt.state;
  motion.reason = worst.doubt.reason;
  return false;
}

std::string MotionEstimationRos::checkGeometry()
{
  try
  {
    for (View& view : views_)
    {
      const CameraInfoWatch& camera_info = view.camera_info;
      if (!camera_info.fault().empty())
      {
        return view.name + ": " + camera_info.fault();
      }
      if (!camera_info.valid())
      {
        return "no " + nh_.resolveName(view.name + "/camera_info") + " so far";
      }
      const auto message = tf_buffer_.lookupTransform(kRoomFrame, camera_info.frame(), ros::Time(0));
      const RigidTransform room_from_optical = rigidFromTransformMsg(message.transform);
      if (geometries_.empty())
      {
        view.room_from_optical = room_from_optical;
      }
      // Rounding of what combines transforms is let through; in mm and of the rotation times the distances, it is less
      // than a micrometre.
      else if (!room_from_optical.isApprox(view.room_from_optical, 1e-10))
      {
        return view.name + ": frame " + camera_info.frame() + " has moved in " + kRoomFrame +
               ", expected it to stay where it was at first";
      }
    }
    if (shape_.wait_for(std::chrono::seconds(0)) == std::future_status::timeout)
    {
      return "the target's shape is being taken from " + setup_.ct_path;
    }
    if (!estimator_)
    {
      std::vector<ProjectionGeometry> geometries;
      for (const View& view : views_)
      {
        geometries.push_back(view.camera_info.geometry(view.name, view.room_from_optical));
      }
      estimator_.emplace(parameters_.estimation, geometries, setup_.targetCentre(), shape_.get(), reference_);
      estimator_->setReference(reference_, reference_covariance_);
      geometries_ = std::move(geometries);
      const TargetShape shape = shape_.get().about(setup_.targetCentre(), reference_.linear());
      const auto tracking = std::find_if(views_.begin(), views_.end(),
                                         [](const View& view) { return view.doubt.state == PatientMotion::OK; });
      const std::uint8_t model = assembler_->exposure()[static_cast<std::size_t>(tracking - views_.begin())]->model;
      observability_ = describe(observability(geometries_, reference_ * setup_.targetCentre(), shape,
                                              static_cast<TrackModel>(model), kRegionExtent));
    }
  }
  catch (const std::exception& error)  // tf2's, of a geometry that is none, or of a CT
  {
    return error.what();
  }
  return std::string();
}

void MotionEstimationRos::findReferences()
{
  const auto& exposure = assembler_->exposure();
  const bool first = history_.empty();
  ros::Time first_stamp, last_stamp;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    View& view = views_[i];
    if (view.doubt.state != PatientMotion::OK)
    {
      continue;
    }
    const ros::Time& stamp = exposure[i]->reference_stamp;
    if (first)
    {
      // The patient is taken to have kept its initial pose until the views track.
      history_.add(nanosecondsFromTime(stamp), reference_);
      first_stamp = first_stamp.isZero() ? stamp : std::min(first_stamp, stamp);
      last_stamp = std::max(last_stamp, stamp);
    }
    if (!view.reference || view.reference->template_stamp != stamp)
    {
      const std::optional<RigidTransform> pose = history_.at(nanosecondsFromTime(stamp));
      if (pose)
      {
        view.reference = Reference{ stamp, *pose };
        continue;
      }
      std::ostringstream reason;
      reason << view.name << " was trained on the exposure at " << stamp << ", whose pose is not known";
      view.doubt = { PatientMotion::NO_REFERENCE, reason.str() };
    }
  }
  if (first)
  {
    judgeStart(first_stamp, last_stamp);
  }
}

void MotionEstimationRos::judgeStart(const ros::Time& first, const ros::Time& last)
{
  const double tolerance = parameters_.pairing_tolerance;
  const double unseen = first_unseen_ ? last.toSec() - first_unseen_->toSec() : 0.0;
  const double apart = last.toSec() - first.toSec();
  if (const double unknown = std::max(unseen, apart); unknown > tolerance)
  {
    const double moved = parameters_.target_speed * unknown;
    reference_covariance_.topLeftCorner<3, 3>() = moved * moved * Eigen::Matrix3d::Identity();
    estimator_->setReference(reference_, reference_covariance_);
  }
  std::ostringstream doubt;
  if (unseen > tolerance)
  {
    doubt << "the first exposures, from " << *first_unseen_ << " to " << last
          << ", did not show the region, and the patient may have left the initial pose by then";
  }
  else if (apart > kStartUp)
  {
    doubt << "the first templates were learnt at different times, from " << first << " to " << last
          << ", and the patient may have moved from the initial pose meanwhile";
  }
  // Stamps may be of another clock than this node's start: then what was heard tells.
  else if (first_heard_->toSec() - first.toSec() > tolerance && started_.toSec() - first.toSec() > kStartUp)
  {
    doubt << "the first templates were learnt at " << first << ", before the first exposure that was heard of here, at "
          << *first_heard_ << ", and the patient may have been anywhere";
  }
  if (!doubt.str().empty())
  {
    ROS_WARN_STREAM(doubt.str());
    gate_->doubt(doubt.str());
  }
}

ViewMeasurement MotionEstimationRos::measure(std::size_t view) const
{
  const Reference& reference = *views_[view].reference;
  const Track track = trackOf(view, *assembler_->exposure()[view], assembler_->offset(view));
  return { reference.room_from_patient, reference.anchor ? track.since(*reference.anchor) : track };
}

Track MotionEstimationRos::trackOf(std::size_t view, const TrackedRegion& region, std::int64_t offset) const
{
  Track track;
  track.centre = { region.region.x_offset + (region.region.width - 1.0) / 2.0,
                   region.region.y_offset + (region.region.height - 1.0) / 2.0 };
  track.model = static_cast<TrackModel>(region.model);
  track.displacement = { region.displacement_x, region.displacement_y };
  track.linear = Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(region.linear.data());
  track.covariance = Eigen::Map<const Matrix6d>(region.covariance.data()).transpose();
  if (offset != 0)
  {
    const Eigen::Vector3d target = (last_pose_ ? last_pose_->second : reference_) * setup_.targetCentre();
    track.covariance.topLeftCorner<2, 2>() += asynchronyCovariance(
        geometries_[view].projectionJacobian(target), parameters_.target_speed, 1e-9 * static_cast<double>(offset));
  }
  return track;
}

void MotionEstimationRos::judgeConsistency(const MotionEstimate& estimate, PatientMotion& motion)
{
  motion.state = estimate.status == EstimateStatus::OK ? PatientMotion::OK : PatientMotion::INCONSISTENT;
  motion.reason = estimate.reason;
  const ConsistencyReport report = consistency_->add(estimate);
  if (motion.state == PatientMotion::OK && !report.consistent)
  {
    motion.state = PatientMotion::INCONSISTENT;
    motion.reason = describe(report);
  }
  motion.views_differ = !rigid_consistency_->add(estimate).consistent;
  differing_ += motion.views_differ ? 1 : 0;
}
}  // namespace xray_tracking
