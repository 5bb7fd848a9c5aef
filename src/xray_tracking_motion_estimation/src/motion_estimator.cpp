#include "xray_tracking_motion_estimation/motion_estimator.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/LU>
#include <boost/math/distributions/chi_squared.hpp>

#include "xray_tracking_core/option_check.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"

namespace xray_tracking
{
namespace
{
constexpr double kConverged = 1e-9;  // mm, and 1e-11 rad: the same over 100 mm
constexpr int kMaxIterations = 20;
constexpr std::size_t kMaxDegreesOfFreedom = 6 * kMaxViews - 3;

/// Over which tissue moves alike [mm]: a region of which it moves a side by a millimetre otherwise turns by a degree.
constexpr double kTissueLength = 57.3;

/// The rotation of a warp's linear part, from columns to rows [rad], and its variance for the warp's covariance.
std::pair<double, double> inPlaneRotation(const Vector6d& warp, const Matrix6d& covariance)
{
  TrackParametersJacobian jacobian;
  const double angle = nearestParameters(TrackModel::EUCLIDEAN, warp, Eigen::Matrix2d::Identity(), jacobian)(2);
  return { angle, (jacobian.row(2) * covariance * jacobian.row(2).transpose()).value() };
}

/// Of a rotation of the room, seen along a view's axis [rad].
double inPlaneRotation(const ProjectionGeometry& view, const Eigen::Matrix3d& rotation)
{
  const Eigen::Matrix3d axes = view.roomFromOptical().linear();
  const Eigen::Matrix3d optical = axes.transpose() * rotation * axes;
  return std::atan2(optical(1, 0) - optical(0, 1), optical(0, 0) + optical(1, 1));
}
}  // namespace

EstimationMethod estimationMethodFromName(const std::string& name)
{
  if (name == "backprojection")
  {
    return EstimationMethod::BACKPROJECTION;
  }
  if (name == "least_squares")
  {
    return EstimationMethod::LEAST_SQUARES;
  }
  throw std::invalid_argument("estimation_method is '" + name + "', expected backprojection or least_squares");
}

void MotionEstimationOptions::validate() const
{
  const auto requirePositive = [](const std::string& key, double value, const std::string& unit)
  { requireOption(value > 0.0 && std::isfinite(value), key, value, "a number > 0" + unit); };
  requireOption(significance > 0.0 && significance < 1.0, "significance", significance, "a probability in (0, 1)");
  requirePositive("floor_sigma", floor_sigma, " mm");
  requirePositive("linear_floor_sigma", linear_floor_sigma, "");
  requirePositive("rotation_sigma", rotation_sigma, " rad");
  requireOption(tissue_sigma >= 0.0 && std::isfinite(tissue_sigma), "tissue_sigma", tissue_sigma, "a number >= 0 mm");
  requirePositive("tissue_time", tissue_time, " s");
  requireOption(min_view_angle > 0.0 && min_view_angle < M_PI / 2, "min_view_angle", min_view_angle,
                "an angle in (0, pi / 2) rad");
}

MotionEstimator::MotionEstimator(const MotionEstimationOptions& options, std::vector<ProjectionGeometry> views,
                                 const Eigen::Vector3d& target_centre, const TargetShape& shape,
                                 const RigidTransform& room_from_patient_reference)
  : options_(options), views_(std::move(views)), target_centre_(target_centre), shape_(shape)
{
  options_.validate();
  requireOption(views_.size() >= 2 && views_.size() <= kMaxViews, "the number of views", views_.size(),
                "2 to " + std::to_string(kMaxViews));
  setReference(room_from_patient_reference, Matrix6d::Zero());
  shape_.validate();

  chi_square_limits_.resize(kMaxDegreesOfFreedom + 1);
  for (std::size_t i = 1; i <= kMaxDegreesOfFreedom; ++i)
  {
    chi_square_limits_[i] = boost::math::quantile(
        boost::math::complement(boost::math::chi_squared(static_cast<double>(i)), options_.significance));
  }
}

void MotionEstimator::setReference(const RigidTransform& room_from_patient_reference, const Matrix6d& covariance)
{
  const Eigen::Vector3d target = room_from_patient_reference * target_centre_;
  std::vector<Eigen::Vector3d> lines_of_sight;
  std::vector<double> pixels;
  Observations all;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const double depth = views_[i].depth(target);
    requireOption(depth > 0.0, "the target's distance from the source of " + views_[i].name(), depth,
                  "a number > 0 mm: a target in front of the source");
    lines_of_sight.push_back((target - views_[i].source()).normalized());
    pixels.push_back(views_[i].pixelPitch().mean() / views_[i].magnification(target));
    all.emplace_back();
    all.back().view = i;
  }
  const double widest = widestAngle(all, lines_of_sight);
  requireOption(
      widest >= options_.min_view_angle,
      "the views" + viewNames(all) + " are as good as parallel: the widest angle of their rays through the target",
      widest, "min_view_angle, " + std::to_string(options_.min_view_angle) + " rad, or more");
  reference_ = room_from_patient_reference;
  reference_target_ = target;
  lines_of_sight_ = std::move(lines_of_sight);
  pixels_ = std::move(pixels);
  reference_covariance_ = covariance;
}

MotionEstimate MotionEstimator::estimate(const std::vector<std::optional<ViewMeasurement>>& measurements) const
{
  if (measurements.size() != views_.size())
  {
    throw std::invalid_argument("the number of measurements is " + std::to_string(measurements.size()) +
                                ", expected one a view");
  }
  MotionEstimate estimate;
  Observations observations;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    if (measurements[i])
    {
      observations.emplace_back();
      estimate.reason = observe(i, *measurements[i], observations.back());
      if (!estimate.reason.empty())
      {
        return estimate;
      }
    }
  }
  // Also false for fewer than two views. The scale of one view tells depth to centimetres, which is no measurement.
  if (!(widestAngle(observations, lines_of_sight_) >= options_.min_view_angle))
  {
    estimate.status = EstimateStatus::UNOBSERVABLE;
    estimate.reason = observations.empty()
                          ? "no view has a track"
                          : "the views that are left do not tell where the target is:" + viewNames(observations);
    return estimate;
  }

  Motion motion{ reference_target_, Eigen::Matrix3d::Identity() };
  Solution solution = Solution::FOUND;
  if (options_.method == EstimationMethod::BACKPROJECTION)
  {
    backProject(measurements, observations, motion, estimate.covariance);
  }
  else
  {
    solution = solveLeastSquares(observations, motion, estimate.covariance);
  }
  // Tracks that contradict each other by many pixels pull the steps to and fro; for the judgement it is near enough.
  if (solution == Solution::NONE || !judgeConsistency(observations, motion, estimate) ||
      (solution == Solution::NEAR && estimate.status == EstimateStatus::OK))
  {
    estimate = MotionEstimate();
    estimate.reason = "the tracks lead to no place in front of all sources";
    return estimate;
  }
  estimate.tissue_variance = tissueVariance(measurements);
  fillPose(motion, estimate);
  return estimate;
}

std::string MotionEstimator::observe(std::size_t view, const ViewMeasurement& measurement,
                                     Observation& observation) const
{
  const auto describe = [&](const auto&... parts)
  {
    std::ostringstream message;
    message << views_[view].name() << ": ";
    (message << ... << parts);
    return message.str();
  };
  const Track& track = measurement.track;
  if (!track.displacement.allFinite() || !track.centre.allFinite())
  {
    return describe("displacement is [", track.displacement.transpose(), "] px of the region at [",
                    track.centre.transpose(), "] px, expected finite numbers");
  }
  // Written so that NaN fails, too.
  if (!(track.linear.determinant() > 0.0) || !track.linear.allFinite())
  {
    return describe("linear part is [", track.linear.row(0), "; ", track.linear.row(1),
                    "], expected finite numbers and a positive determinant");
  }
  observation.view = view;
  observation.model = track.model;
  observation.patch =
      RegionPatch::make(views_[view], measurement.room_from_patient, target_centre_, shape_, track.centre);
  if (!observation.patch.allFinite())
  {
    return describe("the target was not in front of the source when the view was trained");
  }
  observation.reference_rotation = reference_.linear() * measurement.room_from_patient.linear().transpose();

  Vector6d floor;
  floor << Eigen::Vector2d::Constant(options_.floor_sigma / pixels_[view]),
      Eigen::Vector4d::Constant(options_.linear_floor_sigma);
  observation.warp_covariance = track.covariance;
  observation.warp_covariance.diagonal() += floor.cwiseAbs2();
  TrackParametersJacobian jacobian;
  observation.parameters = nearestParameters(track.model, track.warp(), Eigen::Matrix2d::Identity(), jacobian);
  observation.covariance.compute(jacobian * observation.warp_covariance * jacobian.transpose());
  if (!track.covariance.allFinite() || track.covariance.diagonal().minCoeff() < 0.0 ||
      (track.covariance - track.covariance.transpose()).cwiseAbs().maxCoeff() >
          1e-6 * track.covariance.diagonal().maxCoeff() ||
      observation.covariance.info() != Eigen::Success)
  {
    return describe("covariance of (dx, dy, l11, l12, l21, l22) is [", track.covariance.row(0), "; ",
                    track.covariance.row(1), "; ...], expected a symmetric positive semidefinite matrix");
  }
  return std::string();
}

void MotionEstimator::whiten(const Observation& observation, const Motion& motion, Whitened& whitened) const
{
  whitened.warp = observation.patch.predict(views_[observation.view], motion.target,
                                            motion.rotation * observation.reference_rotation, whitened.warp_jacobian);
  TrackParametersJacobian parameters_by_warp;
  const TrackParameters predicted =
      nearestParameters(observation.model, whitened.warp, observation.patch.moments, parameters_by_warp);
  whitened.residual = difference(observation.model, observation.parameters, predicted);
  whitened.jacobian.noalias() = parameters_by_warp * whitened.warp_jacobian;
  const auto root = observation.covariance.matrixL();
  root.solveInPlace(whitened.residual);
  root.solveInPlace(whitened.jacobian);
}

double MotionEstimator::widestAngle(const Observations& observations,
                                    const std::vector<Eigen::Vector3d>& lines_of_sight)
{
  double widest = 0.0;
  for (const Observation& a : observations)
  {
    for (const Observation& b : observations)
    {
      // Between lines, not directions: a view from the opposite side adds no parallax.
      const double sine = lines_of_sight[a.view].cross(lines_of_sight[b.view]).norm();
      widest = std::max(widest, std::asin(std::min(1.0, sine)));
    }
  }
  return widest;
}

std::string MotionEstimator::viewNames(const Observations& observations) const
{
  std::string names;
  for (const Observation& observation : observations)
  {
    names += ' ' + views_[observation.view].name();
  }
  return names;
}

MotionEstimator::Solution MotionEstimator::solveLeastSquares(const Observations& observations, Motion& motion,
                                                             Matrix6d& covariance) const
{
  const double rotation_weight = 1.0 / (options_.rotation_sigma * options_.rotation_sigma);
  Whitened whitened;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration)
  {
    // The prior's gradient is exact: a rotation vector is an eigenvector, to the eigenvalue 1, of what turns a further
    // rotation into its change.
    Matrix6d information = Matrix6d::Zero();
    information.diagonal().tail<3>().setConstant(rotation_weight);
    Vector6d gradient = Vector6d::Zero();
    gradient.tail<3>() = -rotation_weight * vectorFromRotation(motion.rotation);
    for (const Observation& observation : observations)
    {
      whiten(observation, motion, whitened);
      information.noalias() += whitened.jacobian.transpose() * whitened.jacobian;
      gradient.noalias() += whitened.jacobian.transpose() * whitened.residual;
    }
    const Eigen::LLT<Matrix6d> cholesky(information);
    const Vector6d step = cholesky.solve(gradient);
    if (cholesky.info() != Eigen::Success || !step.allFinite())
    {
      return Solution::NONE;
    }
    covariance = cholesky.solve(Matrix6d::Identity());
    motion.target += step.head<3>();
    motion.rotation = rotationFromVector(step.tail<3>()) * motion.rotation;
    if (step.head<3>().norm() + 100.0 * step.tail<3>().norm() < kConverged)
    {
      return Solution::FOUND;
    }
  }
  return Solution::NEAR;
}

void MotionEstimator::backProject(const std::vector<std::optional<ViewMeasurement>>& measurements,
                                  const Observations& observations, Motion& motion, Matrix6d& covariance) const
{
  Eigen::Vector3d diagonal = Eigen::Vector3d::Zero();  // s = diag(M M^T), eq. (5)
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d sum_covariance = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d rotation_information =
      Eigen::Matrix3d::Identity() / (options_.rotation_sigma * options_.rotation_sigma);
  for (const Observation& observation : observations)
  {
    const ProjectionGeometry& view = views_[observation.view];
    const ViewMeasurement& measurement = *measurements[observation.view];
    const Track& track = measurement.track;
    Eigen::Matrix<double, 3, 2> axes;
    axes << view.xDirection(), view.yDirection();
    diagonal += axes.rowwise().squaredNorm();
    const double c = 1.0 / view.magnification(reference_target_);                                   // eq. (3)
    const Eigen::Matrix<double, 3, 2> back_projection = c * axes * view.pixelPitch().asDiagonal();  // eq. (2)

    // Of the target's centre, which need not be the region's.
    const Eigen::Vector3d trained_target = measurement.room_from_patient * target_centre_;
    const Eigen::Vector2d arm = view.project(trained_target) - track.centre;
    const Eigen::Vector2d displacement = track.displacement + track.linear * arm - arm;
    Eigen::Matrix<double, 2, 6> by_warp = Eigen::Matrix<double, 2, 6>::Zero();
    by_warp.leftCols<2>().setIdentity();
    by_warp.block<1, 2>(0, 2) = arm.transpose();
    by_warp.block<1, 2>(1, 4) = arm.transpose();

    // The paper has one reference exposure. What a view's own one has moved by since then is known; the part of it
    // that this view would have seen belongs to its d.
    const Eigen::Vector3d normal = view.roomFromOptical().linear().col(2);
    const Eigen::Vector3d moved = trained_target - reference_target_;
    sum += back_projection * displacement + moved - normal * normal.dot(moved);
    sum_covariance +=
        back_projection * by_warp * observation.warp_covariance * by_warp.transpose() * back_projection.transpose();

    if (track.model != TrackModel::TRANSLATION)
    {
      const auto [angle, variance] = inPlaneRotation(track.warp(), observation.warp_covariance);
      const double known = inPlaneRotation(view, observation.reference_rotation.transpose());
      // Each about its axis as the ones before have turned it.
      motion.rotation *= rotationFromVector((angle + known) * normal);
      rotation_information += normal * normal.transpose() / variance;
    }
  }
  // A room axis perpendicular to all panels has s = 0, though rays that meet parallel panels obliquely do differ. What
  // comes of it is not finite and therefore refused.
  const Eigen::Vector3d normalisation = diagonal.cwiseInverse();  // N, eq. (6)
  motion.target += normalisation.cwiseProduct(sum);               // eq. (7)
  covariance.topLeftCorner<3, 3>() = normalisation.asDiagonal() * sum_covariance * normalisation.asDiagonal();
  covariance.bottomRightCorner<3, 3>() = rotation_information.inverse();
}

bool MotionEstimator::judgeConsistency(const Observations& observations, const Motion& motion,
                                       MotionEstimate& estimate) const
{
  Whitened whitened;
  double squared_pixels = 0.0;
  double squared_millimetres = 0.0;
  estimate.rotation = vectorFromRotation(motion.rotation);
  estimate.chi_square = estimate.rotation.squaredNorm() / (options_.rotation_sigma * options_.rotation_sigma);
  estimate.degrees_of_freedom = -3;
  for (const Observation& observation : observations)
  {
    whiten(observation, motion, whitened);
    estimate.chi_square += whitened.residual.squaredNorm();
    estimate.degrees_of_freedom += static_cast<int>(observation.model);
    TrackResidual residual;
    residual.view = observation.view;
    residual.pixel = pixels_[observation.view];
    residual.residual = observation.parameters.head<2>() - whitened.warp.head<2>();
    residual.covariance = observation.warp_covariance.topLeftCorner<2, 2>();
    residual.covariance.diagonal().array() -= std::pow(options_.floor_sigma / residual.pixel, 2);
    residual.jacobian = whitened.warp_jacobian.topLeftCorner<2, 3>();
    estimate.residuals.push_back(residual);
    squared_pixels += residual.residual.squaredNorm();
    squared_millimetres += (residual.pixel * residual.residual).squaredNorm();
  }
  estimate.disagreement = std::sqrt(squared_pixels / static_cast<double>(observations.size()));
  estimate.disagreement_mm = std::sqrt(squared_millimetres / static_cast<double>(observations.size()));
  if (!std::isfinite(estimate.chi_square))
  {
    return false;
  }

  const double limit = chi_square_limits_[estimate.degrees_of_freedom];
  estimate.status = EstimateStatus::OK;
  if (estimate.chi_square > limit)
  {
    estimate.status = EstimateStatus::INCONSISTENT;
    std::ostringstream message;
    message << "the views disagree by " << estimate.disagreement << " px: chi-square is " << estimate.chi_square
            << " with " << estimate.degrees_of_freedom << " degrees of freedom, expected at most " << limit;
    estimate.reason = message.str();
  }
  return true;
}

double MotionEstimator::tissueVariance(const std::vector<std::optional<ViewMeasurement>>& measurements) const
{
  // One view that counts from long ago may carry the estimate away by itself.
  double share = 0.0;
  for (const std::optional<ViewMeasurement>& measurement : measurements)
  {
    if (measurement)
    {
      const double of_view = measurement->since_anchor ? *measurement->since_anchor / options_.tissue_time : 1.0;
      share = std::max(share, std::min(1.0, of_view));
    }
  }
  return share * options_.tissue_sigma * options_.tissue_sigma;
}

void MotionEstimator::fillPose(const Motion& motion, MotionEstimate& estimate) const
{
  estimate.translation = motion.target - reference_target_;
  const Eigen::Matrix3d rotation = motion.rotation * reference_.linear();
  estimate.room_from_patient.linear() = rotation;
  estimate.room_from_patient.translation() = motion.target - rotation * target_centre_;

  // Of a rotation that tissue feigns the estimate follows as much as of a true one: all where it is measured, nothing
  // where the prior alone tells.
  const Eigen::Matrix3d followed =
      Eigen::Matrix3d::Identity() -
      estimate.covariance.bottomRightCorner<3, 3>() / (options_.rotation_sigma * options_.rotation_sigma);
  estimate.covariance.bottomRightCorner<3, 3>() +=
      estimate.tissue_variance / (kTissueLength * kTissueLength) * followed * followed.transpose();
  estimate.covariance.diagonal().head<3>().array() += estimate.tissue_variance;
  estimate.covariance += reference_covariance_;
  const Matrix6d origin_from_target = pointFromOriginJacobian(-(rotation * target_centre_));
  estimate.pose_covariance = origin_from_target * estimate.covariance * origin_from_target.transpose();
}
}  // namespace xray_tracking
