#include "xray_tracking_motion_estimation/consistency_monitor.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <boost/math/distributions/chi_squared.hpp>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
void ConsistencyOptions::validate() const
{
  requireOption(floor_sigma > 0.0 && std::isfinite(floor_sigma), "floor_sigma", floor_sigma, "a number > 0 mm");
  requireOption(window >= 1, "window", window, "1 or more exposures");
  requireOption(significance > 0.0 && significance < 1.0, "significance", significance, "a probability in (0, 1)");
  requireOption(persistent_sigma >= 0.0 && std::isfinite(persistent_sigma), "persistent_sigma", persistent_sigma,
                "a number >= 0 mm");
}

ConsistencyMonitor::ConsistencyMonitor(const ConsistencyOptions& options) : options_(options)
{
  options_.validate();
  window_.set_capacity(options_.window);
  limits_.resize(2 * kMaxViews - 2);
  for (std::size_t i = 1; i < limits_.size(); ++i)
  {
    limits_[i] = boost::math::quantile(
        boost::math::complement(boost::math::chi_squared(static_cast<double>(i)), options_.significance));
  }
}

ConsistencyReport ConsistencyMonitor::add(const MotionEstimate& estimate)
{
  const Residuals& latest = estimate.residuals;
  if (latest.size() < 2)
  {
    throw std::invalid_argument("the number of views of the estimate is " + std::to_string(latest.size()) +
                                ", expected two or more");
  }
  if (!window_.empty() && !std::equal(latest.begin(), latest.end(), window_.back().begin(), window_.back().end(),
                                      [](const auto& a, const auto& b) { return a.view == b.view; }))
  {
    window_.clear();
  }
  window_.push_back(latest);

  // The mean of the tracks as far as the estimates did not follow them; a motion common to all views is then fitted
  // again, because the mean has other weights than the single exposures.
  Residuals mean = latest;
  const double share = 1.0 / static_cast<double>(window_.size());
  const double unknown_variance =
      options_.persistent_sigma * options_.persistent_sigma + share * options_.floor_sigma * options_.floor_sigma;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  double sum_of_squares = 0.0;
  double squared_pixels = 0.0;
  for (std::size_t i = 0; i < mean.size(); ++i)
  {
    mean[i].residual.setZero();
    mean[i].covariance = unknown_variance / std::pow(mean[i].pixel, 2) * Eigen::Matrix2d::Identity();
    for (const Residuals& residuals : window_)
    {
      mean[i].residual += share * residuals[i].residual;
      mean[i].covariance += share * share * residuals[i].covariance;
    }
    const Eigen::LLT<Eigen::Matrix2d> covariance(mean[i].covariance);
    const Eigen::Matrix<double, 2, 3> jacobian = covariance.matrixL().solve(mean[i].jacobian);
    const Eigen::Vector2d residual = covariance.matrixL().solve(mean[i].residual);
    information.noalias() += jacobian.transpose() * jacobian;
    gradient.noalias() += jacobian.transpose() * residual;
    sum_of_squares += residual.squaredNorm();
    squared_pixels += mean[i].residual.squaredNorm();
  }

  ConsistencyReport report;
  report.exposures = static_cast<int>(window_.size());
  report.degrees_of_freedom = 2 * static_cast<int>(mean.size()) - 3;
  report.chi_square =
      std::max(0.0, sum_of_squares - gradient.dot(Eigen::LLT<Eigen::Matrix3d>(information).solve(gradient)));
  report.disagreement = std::sqrt(squared_pixels / static_cast<double>(mean.size()));
  report.limit = limits_[report.degrees_of_freedom];
  // Written so that NaN fails.
  report.consistent = report.chi_square <= report.limit;
  return report;
}

std::string describe(const ConsistencyReport& report)
{
  std::ostringstream message;
  message << "the views disagree by " << report.disagreement << " px on the mean of " << report.exposures
          << " exposures: chi-square is " << report.chi_square << " with " << report.degrees_of_freedom
          << " degrees of freedom, expected at most " << report.limit;
  return message.str();
}
}  // namespace xray_tracking
