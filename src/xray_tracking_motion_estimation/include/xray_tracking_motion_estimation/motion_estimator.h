#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <boost/container/static_vector.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/region_patch.h"
#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// More views than anybody has; the estimate is made without the heap.
constexpr std::size_t kMaxViews = 16;

enum class EstimationMethod
{
  /// The paper's eqs. (2)-(7), and the rotations that it sketches: linear, right for mutually orthogonal central views.
  BACKPROJECTION,
  /// Weighted reprojection error of one rigid motion, any number and orientation of views.
  LEAST_SQUARES
};

/// @throws std::invalid_argument if `name` is neither "backprojection" nor "least_squares"
EstimationMethod estimationMethodFromName(const std::string& name);

struct MotionEstimationOptions
{
  EstimationMethod method = EstimationMethod::LEAST_SQUARES;

  /// Probability that a good exposure is refused because its views seem to disagree, in (0, 1).
  double significance = 0.001;

  /// Standard deviation of a track along either pixel axis that the tracker's own covariance does not know of, at the
  /// target [mm], > 0: surroundings that move otherwise, blur. Added to every track's covariance in weights, results
  /// and the consistency gate.
  double floor_sigma = 0.135;

  /// The same for each of the four numbers of a track's linear part, > 0: what a rotation out of the plane does to a
  /// region whose depth varies, surroundings. 0.01 makes an angle uncertain by 0.4 degrees.
  double linear_floor_sigma = 0.005;

  /// Standard deviation of the patient's rotation about each room axis since the reference pose, before anything is
  /// measured [rad], > 0. What the tracks do not tell of the rotation is estimated as zero with this uncertainty.
  double rotation_sigma = 0.0349;

  /// Standard deviation, along any room axis, of what tracking takes for the target's motion and is that of other
  /// tissue in its regions [mm], >= 0. It looks like motion to all views, so that no track tells of it: part of the
  /// covariance of the target's centre and, a degree a millimetre, of the rotation that is measured, not of weights and
  /// consistency.
  double tissue_sigma = 0.0;

  /// How long after a view's anchor tissue has got there [s], > 0: at the anchor what it had made of the track was
  /// taken out, and from there on its variance grows in proportion to the time, as a random walk's. A breath.
  double tissue_time = 3.0;

  /// Views whose rays through the target are nowhere further apart than this are refused [rad], in (0, pi / 2).
  double min_view_angle = 0.0873;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// What one view saw of an exposure.
struct ViewMeasurement
{
  RigidTransform room_from_patient;  ///< pose at the exposure that the track counts from
  Track track;
  /// Time since that exposure, if it was registered while the template was tracked [s].
  std::optional<double> since_anchor = std::nullopt;
};

enum class EstimateStatus
{
  OK,
  INCONSISTENT,  ///< the views disagree beyond the significance; every number of the estimate is filled in
  UNOBSERVABLE,  ///< too few views, or as good as parallel ones, are left; the numbers are zero
  INVALID        ///< a measurement is not finite or not possible; the numbers are zero
};

/// How far one view's track is from where the estimate puts it.
struct TrackResidual
{
  std::size_t view = 0;
  Eigen::Vector2d residual = Eigen::Vector2d::Zero();    ///< displacement of the region's centre less estimate [px]
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of the displacement, without the floor [px^2]
  Eigen::Matrix<double, 2, 3> jacobian = Eigen::Matrix<double, 2, 3>::Zero();  ///< by the target's centre [px / mm]
  double pixel = 0.0;                                                          ///< its size at the target [mm]
};

struct MotionEstimate
{
  EstimateStatus status = EstimateStatus::INVALID;
  std::string reason;  ///< empty if OK

  /// Motion of the target's centre since the reference pose, room axes [mm].
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  /// Rotation vector of the target about its centre since the reference pose, room axes [rad].
  Eigen::Vector3d rotation = Eigen::Vector3d::Zero();
  /// Of the target's centre [mm] and a further rotation vector about it, room axes [rad]. A direction of rotation that
  /// was not seen has the options' variance.
  Matrix6d covariance = Matrix6d::Zero();

  /// Part of the centre's variance along any axis that is tissue's, the same for many exposures [mm^2].
  double tissue_variance = 0.0;

  /// The reference pose moved by the above, eq. (8).
  RigidTransform room_from_patient = RigidTransform::Identity();
  /// Of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes [rad]): `covariance`
  /// over the lever from the target to the origin, which may be long.
  Matrix6d pose_covariance = Matrix6d::Zero();

  double disagreement = 0.0;     ///< RMS over the views of the distance between track and reprojected estimate [px]
  double disagreement_mm = 0.0;  ///< the same at the target [mm]
  double chi_square = 0.0;       ///< squared residuals in units of track covariance and floor, rotation in its sigma
  int degrees_of_freedom = 0;    ///< of chi_square: the tracks' parameters less three
  boost::container::static_vector<TrackResidual, kMaxViews> residuals;  ///< of the views that took part
};

/// From 2D tracks in two or more views to the 3D motion of the target (paper, section 2).
class MotionEstimator
{
public:
  /// @param target_centre patient frame [mm]
  /// @param shape how the tracked target is spread, TargetShape::isotropic(target_centre) if it is not known
  /// @param room_from_patient_reference as of setReference(), without uncertainty
  /// @throws std::invalid_argument for bad options, fewer than two or more than kMaxViews views, a target that is not
  /// in
  ///   front of every source, or views that are as good as parallel, naming the views
  MotionEstimator(const MotionEstimationOptions& options, std::vector<ProjectionGeometry> views,
                  const Eigen::Vector3d& target_centre, const TargetShape& shape,
                  const RigidTransform& room_from_patient_reference);

  /// @param room_from_patient_reference pose that motion is counted from; at it, c of eq. (3) is taken, too
  /// @param covariance of that pose, as MotionEstimate::covariance; goes into every estimate's
  /// @throws std::invalid_argument as the constructor for the target and the views, whereupon nothing is changed
  void setReference(const RigidTransform& room_from_patient_reference, const Matrix6d& covariance);

  /// @param measurements one a view, in the order of the views; nothing where a view has no track
  /// @throws std::invalid_argument if there are more or fewer than views
  MotionEstimate estimate(const std::vector<std::optional<ViewMeasurement>>& measurements) const;

private:
  /// What one view's measurement comes down to.
  struct Observation
  {
    std::size_t view;
    TrackModel model;
    RegionPatch patch;
    Eigen::Matrix3d reference_rotation;  ///< of the target from the view's reference exposure to the common one
    TrackParameters parameters;
    Eigen::LLT<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 6, 6>> covariance;  ///< of the parameters
    Matrix6d warp_covariance;                                                               ///< with the floors
  };
  using Observations = boost::container::static_vector<Observation, kMaxViews>;

  /// Residual and its derivative in units of the observation's standard deviations.
  struct Whitened
  {
    TrackParameters residual;
    TrackParametersJacobian jacobian;  ///< of the prediction, by (centre, rotation)
    Vector6d warp;                     ///< predicted
    Matrix6d warp_jacobian;
  };

  struct Motion
  {
    Eigen::Vector3d target;    ///< room [mm]
    Eigen::Matrix3d rotation;  ///< since the reference pose
  };

  /// @return what is wrong with the measurement; empty if nothing is
  std::string observe(std::size_t view, const ViewMeasurement& measurement, Observation& observation) const;
  void whiten(const Observation& observation, const Motion& motion, Whitened& whitened) const;
  /// The largest angle between the lines of sight of two of the views that are there [rad].
  static double widestAngle(const Observations& observations, const std::vector<Eigen::Vector3d>& lines_of_sight);
  enum class Solution
  {
    FOUND,
    NEAR,  ///< the steps had not come to rest
    NONE   ///< not in front of all sources
  };
  Solution solveLeastSquares(const Observations& observations, Motion& motion, Matrix6d& covariance) const;
  void backProject(const std::vector<std::optional<ViewMeasurement>>& measurements, const Observations& observations,
                   Motion& motion, Matrix6d& covariance) const;
  bool judgeConsistency(const Observations& observations, const Motion& motion, MotionEstimate& estimate) const;
  double tissueVariance(const std::vector<std::optional<ViewMeasurement>>& measurements) const;
  void fillPose(const Motion& motion, MotionEstimate& estimate) const;
  std::string viewNames(const Observations& observations) const;

  MotionEstimationOptions options_;
  std::vector<ProjectionGeometry> views_;
  Eigen::Vector3d target_centre_;
  TargetShape shape_;
  RigidTransform reference_;
  Matrix6d reference_covariance_ = Matrix6d::Zero();
  Eigen::Vector3d reference_target_;             ///< room [mm]
  std::vector<Eigen::Vector3d> lines_of_sight_;  ///< to the reference target, unit
  std::vector<double> pixels_;                   ///< their sizes at the reference target [mm]
  std::vector<double> chi_square_limits_;        ///< by degrees of freedom
};
}  // namespace xray_tracking
