#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <Eigen/Core>

#include "xray_tracking_motion_estimation/exposure_estimator.h"
#include "xray_tracking_motion_estimation/motion_monitor_options.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"
#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
/// Where a published pose comes from; values as in xray_tracking_msgs/PatientMotion.
enum class PoseSource : std::uint8_t
{
  NONE = 0,
  TRACKED = 1,
  REGISTERED = 2
};

/// What is said of an exposure, once.
struct MotionDecision
{
  std::int64_t stamp = 0;  ///< [ns]
  MotionState state = MotionState::WAITING;
  std::string reason;  ///< why there is no pose; empty if there is one

  PoseSource source = PoseSource::NONE;
  std::string not_registered;  ///< why the pose is not a registered one; empty if it is
  RigidTransform room_from_patient = RigidTransform::Identity();
  /// Of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes [rad]).
  PoseCovariance pose_covariance = PoseCovariance::Zero();
  double tissue_variance = 0.0;  ///< as in MotionEstimate; none in a registered pose
  /// Of the target's centre since the initial pose, room axes [mm], and its covariance [mm^2].
  Eigen::Vector3d displacement = Eigen::Vector3d::Zero();
  Eigen::Matrix3d displacement_covariance = Eigen::Matrix3d::Zero();

  // Of the tracks, whatever the source; zeros where there is no estimate.
  bool views_differ = false;
  double disagreement = 0.0;  ///< [px]
  double chi_square = 0.0;
  int degrees_of_freedom = 0;
  int views = 0;  ///< that took part

  double cpu_seconds = 0.0;   ///< of trackers
  double wall_seconds = 0.0;  ///< from the images' arrival
};

/// What is said of an exposure, of whose pose tracks and maybe a registration tell: which of the two counts, or why
/// none does. Knows what ends poses for more than one exposure. No clock.
class DecisionRules
{
public:
  /// @param initial_pose what displacements count from; @param target_centre patient frame [mm]
  DecisionRules(PoseMethod method, const RigidTransform& initial_pose, const Eigen::Vector3d& target_centre);

  /// Time starts again. @param doubt why no pose is believed before a refinement is accepted; empty if none is needed
  void restart(const std::string& doubt);
  /// Registration and tracks contradict each other: no tracked pose until a refinement is accepted.
  void contradict(const std::string& why) { contradiction_ = why; }
  /// A refinement is accepted.
  void confirm();

  /// @param refinement accepted, of this exposure; @param not_registered why there is none
  MotionDecision decide(const TrackedExposure& exposure, const ExposureEstimate& tracks,
                        const std::optional<Refinement>& refinement, const std::string& not_registered) const;

  /// Of the target's centre since the initial pose, room axes [mm].
  Eigen::Vector3d displacement(const RigidTransform& room_from_patient) const;
  /// Since then [rad].
  double rotation(const RigidTransform& room_from_patient) const;

private:
  PoseMethod method_;
  RigidTransform initial_pose_;
  Eigen::Vector3d target_centre_;
  std::string unconfirmed_;
  std::string contradiction_;
};
}  // namespace xray_tracking
