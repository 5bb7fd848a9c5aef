#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_motion_estimation/consistency_monitor.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/motion_memory.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"
#include "xray_tracking_motion_estimation/tracked_view.h"
#include "xray_tracking_motion_estimation/view_references.h"

namespace xray_tracking
{
struct ExposureEstimatorOptions
{
  std::vector<std::string> views;  ///< names, two or more
  double pairing_tolerance = 0.0;  ///< of the stamps of one exposure [s]
  double target_speed = 15.0;      ///< standard deviation along any axis [mm/s], for what nobody has seen
  MotionEstimationOptions estimation;
  ConsistencyOptions consistency;
  ConsistencyOptions rigid_consistency;  ///< beyond which the views of a rigid target differ
};

/// What the tracks of an exposure say of the patient's pose.
struct ExposureEstimate
{
  MotionState state = MotionState::WAITING;  ///< OK if there is a pose
  std::string reason;                        ///< why there is none
  std::optional<MotionEstimate> estimate;    ///< if the views can be combined: OK or INCONSISTENT
  bool views_differ = false;                 ///< by more than those of a rigid target do
  /// Of the first estimate alone: why the patient may not have been at the initial pose; empty if nothing says so.
  std::string start_doubt;
};

/// From the tracks of one exposure after another to poses: knows what each view's track is relative to, which views are
/// of use, and whether these agree. No clock.
class ExposureEstimator
{
public:
  /// @param initial_pose of the first templates; @param target_centre patient frame [mm]
  /// @throws std::invalid_argument for bad options
  ExposureEstimator(const ExposureEstimatorOptions& options, const RigidTransform& initial_pose,
                    const Eigen::Vector3d& target_centre);

  /// @throws std::invalid_argument as MotionEstimator
  void setGeometry(const std::vector<ProjectionGeometry>& geometries, const TargetShape& shape);
  const std::vector<ProjectionGeometry>& geometries() const { return geometries_; }
  /// What the geometry sees of motion, for people; empty before the first tracks.
  const std::string& observability() const { return observability_; }

  /// When this was started, and the earliest exposure that was heard of, by the clock that stamps are of [ns]: first
  /// templates that are older were learnt nobody knows where.
  void heardFrom(std::int64_t started, std::int64_t first_exposure);

  /// With a geometry. To be called with every exposure, in their order; once more after accept().
  ExposureEstimate estimate(const TrackedExposure& exposure);

  /// The pose of an exposure, which later templates may be learnt from.
  void add(const TrackedExposure& exposure, const RigidTransform& room_from_patient, bool registered);

  /// From here on motion counts from the refined pose, and the tracks of the views in `exposure` from there. If that
  /// pose was claimed, all others are forgotten.
  /// @param exposure the refined one
  /// @throws std::invalid_argument if the pose is of no use, whereupon nothing is changed
  void accept(const Refinement& refinement, const TrackedExposure& exposure);

  /// With a geometry. Why motion cannot count from a pose, as accept() would say; empty if it can.
  std::string faultOf(const RigidTransform& room_from_patient) const;

  /// As at first, but for the geometry and for what templates were learnt of.
  void restart();

  /// What to go on with elsewhere, but for the last pose, and of the views what is usual and stated; nothing if no pose
  /// is known.
  std::optional<MotionMemory> memory() const;
  /// With a geometry; the same one. Templates that the memory does not know have no reference.
  /// @throws std::invalid_argument if it is of another number of views, or its pose is of no use
  void takeUp(const MotionMemory& memory);

  /// Whether no pose is known so far.
  bool empty() const { return references_.empty(); }
  /// The pose that motion is counted from.
  const RigidTransform& reference() const { return reference_; }

  /// Why a view takes no part in an exposure; OK if it does.
  struct Doubt
  {
    MotionState state = MotionState::OK;
    std::string reason;
  };
  /// In the last estimate.
  const Doubt& doubt(std::size_t view) const { return doubts_[view]; }

  /// Whether the last accepted refinement did not see the target in a view; it takes no part until one does.
  bool isHidden(std::size_t view) const { return sights_[view].hidden; }
  /// Whether the first refinement that compared a view's template did not see the target: what hid it may have been
  /// learnt. The view takes no part until it has learnt anew.
  bool isSpoilt(std::size_t view, const TrackedView& tracked) const
  {
    return sights_[view].template_stamp == tracked.reference_stamp && sights_[view].template_hidden;
  }

  /// When a view's latest template whose pose is known was learnt [ns]; nothing if there is none.
  std::optional<std::int64_t> templateStamp(std::size_t view) const { return references_.templateStamp(view); }
  /// Where a view's region would have to be, with the patient there; nothing if that is not known. @return [px]
  std::optional<cv::Rect> regionAt(std::size_t view, const RigidTransform& room_from_patient) const;

private:
  Doubt doubtOf(std::size_t view, const TrackedExposure& exposure) const;
  /// @return false, and the worst doubt in the estimate, if fewer than two views take part
  bool enoughViews(ExposureEstimate& estimate) const;
  /// Doubts views whose reference exposure's pose is not known. @return as ExposureEstimate::start_doubt
  std::string findReferences(const TrackedExposure& exposure);
  /// Of the first templates' exposures [ns]: whether the patient was at the initial pose then.
  std::string judgeStart(std::int64_t first, std::int64_t last);
  /// A view's track with what the target may have moved by between the views.
  Track trackOf(std::size_t view, const TrackedView& tracked) const;

  ExposureEstimatorOptions options_;
  RigidTransform initial_pose_;
  Eigen::Vector3d target_centre_;
  std::vector<ProjectionGeometry> geometries_;
  std::optional<TargetShape> shape_;
  std::optional<MotionEstimator> estimator_;
  RigidTransform reference_;
  Matrix6d reference_covariance_ = Matrix6d::Zero();  ///< of the target's centre and rotation
  RigidTransform last_pose_;                          ///< about where the target is
  ConsistencyMonitor consistency_;
  ConsistencyMonitor rigid_consistency_;  ///< refuses nothing
  ViewReferences references_;
  std::vector<Doubt> doubts_;
  std::vector<ViewSight> sights_;  ///< but for what is usual and stated
  std::vector<std::optional<ViewMeasurement>> measurements_;
  std::int64_t started_ = 0;
  std::int64_t first_heard_ = 0;
  std::optional<std::int64_t>
      first_unseen_;  ///< first exposure that gave a view no template while nothing was measured
  std::string observability_;
};
}  // namespace xray_tracking
