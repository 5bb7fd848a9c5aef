#include "xray_tracking_motion_estimation/motion_estimator.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <boost/math/distributions/chi_squared.hpp>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr double kConverged = 1e-9;  // mm
constexpr int kMaxIterations = 20;

/// Refuses views that see the target along one line only: nothing would fix its place on that line.
void requireParallax(const std::vector<ProjectionGeometry>& views, const Eigen::Vector3d& target, double min_angle)
{
  double widest = 0.0;
  for (const ProjectionGeometry& a : views)
  {
    for (const ProjectionGeometry& b : views)
    {
      const Eigen::Vector3d ray_a = (target - a.source()).normalized();
      const Eigen::Vector3d ray_b = (target - b.source()).normalized();
      // Between lines, not directions: a view from the opposite side adds no parallax.
      widest = std::max(widest, std::asin(std::min(1.0, ray_a.cross(ray_b).norm())));
    }
  }
  if (!(widest >= min_angle))
  {
    std::ostringstream message;
    message << "the views";
    for (const ProjectionGeometry& view : views)
    {
      message << ' ' << view.name();
    }
    message << " are as good as parallel: their rays through the target are at most " << widest
            << " rad apart, expected min_view_angle " << min_angle << " rad or more";
    throw std::invalid_argument(message.str());
  }
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
  throw std::invalid_argument("method is '" + name + "', expected backprojection or least_squares");
}

void MotionEstimationOptions::validate() const
{
  requireOption(significance > 0.0 && significance < 1.0, "significance", significance, "a probability in (0, 1)");
  requireOption(floor_sigma > 0.0 && std::isfinite(floor_sigma), "floor_sigma", floor_sigma, "a number > 0 px");
  requireOption(rotation_sigma > 0.0 && std::isfinite(rotation_sigma), "rotation_sigma", rotation_sigma,
                "a number > 0 rad");
  requireOption(min_view_angle > 0.0 && min_view_angle < M_PI / 2, "min_view_angle", min_view_angle,
                "an angle in (0, pi / 2) rad");
}

MotionEstimator::MotionEstimator(const MotionEstimationOptions& options, std::vector<ProjectionGeometry> views,
                                 const Eigen::Vector3d& target_centre,
                                 const RigidTransform& room_from_patient_reference)
  : options_(options),
    views_(std::move(views)),
    target_centre_(target_centre),
    reference_(room_from_patient_reference),
    reference_target_(reference_ * target_centre_)
{
  options_.validate();
  requireOption(views_.size() >= 2, "the number of views", views_.size(), "two or more");
  for (const ProjectionGeometry& view : views_)
  {
    requireOption(view.depth(reference_target_) > 0.0, "the target's distance from the source of " + view.name(),
                  view.depth(reference_target_), "a number > 0 mm: a target in front of the source");
  }
  requireParallax(views_, reference_target_, options_.min_view_angle);

  Eigen::Vector3d sum = Eigen::Vector3d::Zero();  // s = diag(M M^T), eq. (5)
  for (const ProjectionGeometry& view : views_)
  {
    Eigen::Matrix<double, 3, 2> axes;
    axes << view.xDirection(), view.yDirection();
    sum += axes.rowwise().squaredNorm();
    const double c = 1.0 / view.magnification(reference_target_);            // eq. (3)
    back_projections_.push_back(c * axes * view.pixelPitch().asDiagonal());  // eq. (2)
  }
  // A direction that no panel sees would have s = 0; parallax rules it out.
  normalisation_ = sum.cwiseInverse();
}

MotionEstimate MotionEstimator::estimate(const std::vector<ViewMeasurement>& measurements) const
{
  requireOption(measurements.size() == views_.size(), "the number of measurements", measurements.size(), "one a view");
  MotionEstimate invalid;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    invalid.reason = fault(i, measurements[i]);
    if (!invalid.reason.empty())
    {
      return invalid;
    }
  }

  MotionEstimate estimate;
  const bool solved = options_.method == EstimationMethod::BACKPROJECTION ? backProject(measurements, estimate)
                                                                          : solveLeastSquares(measurements, estimate);
  if (!solved || !judgeConsistency(measurements, estimate))
  {
    invalid.reason = "the tracks lead to no place in front of all sources";
    return invalid;
  }
  fillPose(estimate);
  return estimate;
}

std::string MotionEstimator::fault(std::size_t view, const ViewMeasurement& measurement) const
{
  const auto describe = [&](const auto&... parts)
  {
    std::ostringstream message;
    message << views_[view].name() << ": ";
    (message << ... << parts);
    return message.str();
  };
  if (!measurement.displacement.allFinite())
  {
    return describe("displacement is [", measurement.displacement.transpose(), "] px, expected finite numbers");
  }
  const Eigen::Matrix2d& covariance = measurement.covariance;
  if (!covariance.allFinite() || covariance.diagonal().minCoeff() < 0.0 ||
      !covariance.isApprox(covariance.transpose()) ||
      Eigen::LLT<Eigen::Matrix2d>(measurementCovariance(measurement)).info() != Eigen::Success)
  {
    return describe("covariance is [", covariance.row(0), "; ", covariance.row(1),
                    "] px^2, expected a symmetric positive semidefinite matrix");
  }
  if (!observedPixel(view, measurement).allFinite())
  {
    return describe("the target was not in front of the source when the view was trained");
  }
  return std::string();
}

Eigen::Matrix2d MotionEstimator::measurementCovariance(const ViewMeasurement& measurement) const
{
  return measurement.covariance + options_.floor_sigma * options_.floor_sigma * Eigen::Matrix2d::Identity();
}

Eigen::Vector2d MotionEstimator::observedPixel(std::size_t view, const ViewMeasurement& measurement) const
{
  return views_[view].project(measurement.room_from_patient * target_centre_) + measurement.displacement;
}

bool MotionEstimator::solveLeastSquares(const std::vector<ViewMeasurement>& measurements,
                                        MotionEstimate& estimate) const
{
  Eigen::Vector3d target = reference_target_;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration)
  {
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < views_.size(); ++i)
    {
      const Jacobian jacobian = views_[i].projectionJacobian(target);
      const Jacobian weighted = measurementCovariance(measurements[i]).inverse() * jacobian;
      information.noalias() += jacobian.transpose() * weighted;
      gradient.noalias() += weighted.transpose() * (observedPixel(i, measurements[i]) - views_[i].project(target));
    }
    const Eigen::LLT<Eigen::Matrix3d> cholesky(information);
    const Eigen::Vector3d step = cholesky.solve(gradient);
    if (cholesky.info() != Eigen::Success || !step.allFinite())
    {
      return false;
    }
    target += step;
    if (step.norm() < kConverged)
    {
      estimate.translation = target - reference_target_;
      estimate.translation_covariance = cholesky.solve(Eigen::Matrix3d::Identity());
      return true;
    }
  }
  return false;
}

bool MotionEstimator::backProject(const std::vector<ViewMeasurement>& measurements, MotionEstimate& estimate) const
{
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    // The paper has one reference exposure. What a view's own one has moved by since then is known; the part of it
    // that this view would have seen belongs to its d.
    const Eigen::Vector3d normal = views_[i].roomFromOptical().linear().col(2);
    const Eigen::Vector3d moved = measurements[i].room_from_patient * target_centre_ - reference_target_;
    sum += back_projections_[i] * measurements[i].displacement + moved - normal * normal.dot(moved);
    covariance += back_projections_[i] * measurementCovariance(measurements[i]) * back_projections_[i].transpose();
  }
  estimate.translation = normalisation_.cwiseProduct(sum);  // eq. (7)
  estimate.translation_covariance = normalisation_.asDiagonal() * covariance * normalisation_.asDiagonal();
  return true;
}

bool MotionEstimator::judgeConsistency(const std::vector<ViewMeasurement>& measurements, MotionEstimate& estimate) const
{
  const Eigen::Vector3d target = reference_target_ + estimate.translation;
  double squared_pixels = 0.0;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const Eigen::Vector2d residual = observedPixel(i, measurements[i]) - views_[i].project(target);
    squared_pixels += residual.squaredNorm();
    estimate.chi_square += residual.dot(measurementCovariance(measurements[i]).inverse() * residual);
  }
  estimate.disagreement = std::sqrt(squared_pixels / static_cast<double>(views_.size()));
  estimate.degrees_of_freedom = 2 * static_cast<int>(views_.size()) - 3;
  if (!std::isfinite(estimate.chi_square))
  {
    return false;
  }

  const boost::math::chi_squared distribution(estimate.degrees_of_freedom);
  if (boost::math::cdf(boost::math::complement(distribution, estimate.chi_square)) >= options_.significance)
  {
    estimate.status = EstimateStatus::OK;
    return true;
  }
  estimate.status = EstimateStatus::INCONSISTENT;
  std::ostringstream message;
  message << "the views disagree by " << estimate.disagreement << " px: chi-square is " << estimate.chi_square
          << " with " << estimate.degrees_of_freedom << " degrees of freedom, expected at most "
          << boost::math::quantile(boost::math::complement(distribution, options_.significance));
  estimate.reason = message.str();
  return true;
}

void MotionEstimator::fillPose(MotionEstimate& estimate) const
{
  estimate.room_from_patient = reference_;
  estimate.room_from_patient.pretranslate(estimate.translation);

  // With the target's centre at p, t = p - R c: a rotation error d moves the origin by -d x (R c) = [R c]x d.
  const double variance = options_.rotation_sigma * options_.rotation_sigma;
  const Eigen::Matrix3d lever = skew(reference_.linear() * target_centre_);
  estimate.pose_covariance.topLeftCorner<3, 3>() =
      estimate.translation_covariance + variance * lever * lever.transpose();
  estimate.pose_covariance.topRightCorner<3, 3>() = variance * lever;
  estimate.pose_covariance.bottomLeftCorner<3, 3>() = variance * lever.transpose();
  estimate.pose_covariance.bottomRightCorner<3, 3>() = variance * Eigen::Matrix3d::Identity();
}
}  // namespace xray_tracking
