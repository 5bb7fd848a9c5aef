#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
enum class EstimationMethod
{
  BACKPROJECTION,  ///< the paper's eqs. (2)-(7): linear, right for mutually orthogonal central views
  LEAST_SQUARES    ///< weighted reprojection error, any number and orientation of views
};

/// @throws std::invalid_argument if `name` is neither "backprojection" nor "least_squares"
EstimationMethod estimationMethodFromName(const std::string& name);

struct MotionEstimationOptions
{
  EstimationMethod method = EstimationMethod::LEAST_SQUARES;

  /// Probability that a good exposure is refused because its views seem to disagree, in (0, 1).
  double significance = 0.001;

  /// Standard deviation of a track along either pixel axis that the tracker's own covariance does not know of [px], >
  /// 0: surroundings that move otherwise, rotation, blur. Added to every track's covariance in weights, results and the
  /// consistency gate.
  double floor_sigma = 0.5;

  /// Standard deviation of the patient's rotation about each room axis since the reference [rad], > 0. Rotation is not
  /// measured; this is what the pose's covariance says of it.
  double rotation_sigma = 0.0175;

  /// Views whose rays through the target are nowhere further apart than this are refused [rad], in (0, pi / 2).
  double min_view_angle = 0.0873;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// What one view saw of an exposure.
struct ViewMeasurement
{
  RigidTransform room_from_patient;  ///< pose at the exposure that the view's template was trained on
  Eigen::Vector2d displacement;      ///< of the target since that exposure, along columns and rows [px]
  Eigen::Matrix2d covariance;        ///< of the displacement [px^2], symmetric, positive semidefinite
};

enum class EstimateStatus
{
  OK,
  INCONSISTENT,  ///< the views disagree beyond the significance; every number of the estimate is filled in
  INVALID        ///< a measurement is not finite or not possible; the numbers are zero
};

struct MotionEstimate
{
  EstimateStatus status = EstimateStatus::INVALID;
  std::string reason;  ///< empty if OK

  /// Motion of the target's centre since the reference pose, room axes [mm].
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Matrix3d translation_covariance = Eigen::Matrix3d::Zero();  ///< [mm^2]

  /// The reference pose moved by `translation`, eq. (8); its rotation is the reference's.
  RigidTransform room_from_patient = RigidTransform::Identity();
  /// Of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes [rad]). Rotation
  /// has the options' standard deviation; what it does to the origin, which may lie far from the target, is in the
  /// translation block and in the correlation: carried to the target's centre it cancels.
  Eigen::Matrix<double, 6, 6> pose_covariance = Eigen::Matrix<double, 6, 6>::Zero();

  double disagreement = 0.0;   ///< RMS over the views of the distance between track and reprojected estimate [px]
  double chi_square = 0.0;     ///< sum of squared residuals in units of track covariance and floor
  int degrees_of_freedom = 0;  ///< of chi_square: two a view, less three
};

/// From 2D tracks in two or more views to the 3D motion of the target (paper, section 2).
class MotionEstimator
{
public:
  /// @param target_centre patient frame [mm]
  /// @param room_from_patient_reference pose that motion is counted from; at it, c of eq. (3) is taken, too
  /// @throws std::invalid_argument for bad options, fewer than two views, a target that is not in front of every
  ///   source, or views that are as good as parallel, naming the views
  MotionEstimator(const MotionEstimationOptions& options, std::vector<ProjectionGeometry> views,
                  const Eigen::Vector3d& target_centre, const RigidTransform& room_from_patient_reference);

  /// @param measurements one a view, in the order of the views
  /// @throws std::invalid_argument if there are more or fewer than views
  MotionEstimate estimate(const std::vector<ViewMeasurement>& measurements) const;

private:
  using Jacobian = Eigen::Matrix<double, 2, 3>;

  /// [mm / px], eq. (2): the motion parallel to the panel at the target's depth that moves it by a pixel
  using BackProjection = Eigen::Matrix<double, 3, 2>;

  /// What is wrong with a view's measurement; empty if nothing is.
  std::string fault(std::size_t view, const ViewMeasurement& measurement) const;
  Eigen::Matrix2d measurementCovariance(const ViewMeasurement& measurement) const;
  Eigen::Vector2d observedPixel(std::size_t view, const ViewMeasurement& measurement) const;
  // These return false if the measurements have no solution in front of all sources.
  bool solveLeastSquares(const std::vector<ViewMeasurement>& measurements, MotionEstimate& estimate) const;
  bool backProject(const std::vector<ViewMeasurement>& measurements, MotionEstimate& estimate) const;
  bool judgeConsistency(const std::vector<ViewMeasurement>& measurements, MotionEstimate& estimate) const;
  void fillPose(MotionEstimate& estimate) const;

  MotionEstimationOptions options_;
  std::vector<ProjectionGeometry> views_;
  Eigen::Vector3d target_centre_;
  RigidTransform reference_;
  Eigen::Vector3d reference_target_;  ///< room [mm]
  std::vector<BackProjection> back_projections_;
  Eigen::Vector3d normalisation_;  ///< diagonal of the paper's N, eq. (6)
};
}  // namespace xray_tracking
