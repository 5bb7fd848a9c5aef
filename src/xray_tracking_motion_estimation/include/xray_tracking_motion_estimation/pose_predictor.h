#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/axis_predictor.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"

namespace xray_tracking
{
struct PosePredictorOptions
{
  /// What predictions are needed for: from an exposure to when the beam can follow it [s], in (0, 1].
  double latency = 0.115;

  /// After so long without an exposure the past says nothing: no prediction, and the next exposure starts over [s], >
  /// latency.
  double max_gap = 1.0;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// Where the patient is expected to be.
struct PosePrediction
{
  std::int64_t stamp;  ///< the time that it is for [ns]
  RigidTransform room_from_patient;
  /// Of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes [rad]).
  PoseCovariance covariance;
};

/// The patient's pose a little after its last measurement: the target's centre and the rotation about it, every room
/// axis by itself (AxisPredictor).
///
/// A part of a pose's covariance is an error that stays the same for many exposures (geometry, rotation that nobody
/// measures); it is kept in full in the prediction's, with its correlations, and no filter averages it away.
///
/// Constant time, no allocation.
class PosePredictor
{
public:
  /// @param target_centre patient frame [mm]
  /// @throws std::invalid_argument for bad options
  PosePredictor(const PosePredictorOptions& options, const Eigen::Vector3d& target_centre);

  /// A measured pose, its covariance as in PosePrediction. It is ignored unless it is newer than the last one, finite,
  /// and its variances are positive. After a gap, or after more than half a radian of rotation, prediction starts over.
  /// @param stamp exposure time [ns]
  /// @param tissue_variance part of the centre's variance along any axis that stays for many exposures and is no noise
  /// [mm^2], >= 0
  /// @return false if it was ignored
  bool add(std::int64_t stamp, const RigidTransform& room_from_patient, const PoseCovariance& covariance,
           double tissue_variance = 0.0);

  /// @param stamp [ns], from the last pose's up to the maximal gap later
  /// @return nothing out of this range, or if there is no pose
  std::optional<PosePrediction> predict(std::int64_t stamp) const;

  /// The reference has been corrected: what was measured as `before` is now known to be `after`; this is no motion.
  void correct(const RigidTransform& before, const RigidTransform& after);

  void reset() { last_stamp_.reset(); }

private:
  /// Target's centre in the room [mm], rotation vector since `first_rotation_` [rad] times kArm.
  Eigen::Matrix<double, 6, 1> coordinates(const RigidTransform& room_from_patient) const;

  PosePredictorOptions options_;
  Eigen::Vector3d target_centre_;
  std::optional<std::int64_t> last_stamp_;
  Eigen::Matrix3d first_rotation_ = Eigen::Matrix3d::Identity();
  std::array<AxisPredictor, 6> axes_;
  PoseCovariance lasting_covariance_ = PoseCovariance::Zero();  ///< of coordinates()
};
}  // namespace xray_tracking
