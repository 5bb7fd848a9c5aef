#pragma once

#include <Eigen/Core>

#include "point_sampler.h"
#include "warp.h"

namespace xray_tracking
{
/// Patterns over the template points that must not move the estimate, as an orthonormal basis (points x patterns).
class Nuisance
{
public:
  /// @param patterns one a column, in order of precedence: each loses what those before it have of it
  explicit Nuisance(const Eigen::MatrixXd& patterns);

  /// Takes the patterns out of every column.
  template <typename Derived>
  void removeFrom(Eigen::MatrixBase<Derived>& columns) const
  {
    columns -= basis_ * (basis_.transpose() * columns).eval();
  }
  const Eigen::MatrixXf& basis() const { return basis_; }

private:
  Eigen::MatrixXf basis_;
};

/// The monomials of up to second order in coordinates that run from -1 to 1 over the region: slow shading.
Eigen::MatrixXd shadingPatterns(const Points& points, const cv::Rect& region);

/// Covariance of the differences that an overlay moving on its own makes (HyperplaneTracker), without the nuisance's
/// patterns, scaled to unit mean variance.
Eigen::MatrixXf backgroundCovariance(const Points& points, const Nuisance& nuisance);

using Predictor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic>;  ///< A^T, points x parameters

/// Solves the training's normal equations: A^T = (H H^T + n (C + lambda))^-1 H M for n motions. lambda, the ridge that
/// a finite number of motions needs beside the known covariance, is the one with which motions kept out of the training
/// are predicted best under C. Nuisance patterns are removed on both sides; A is scaled so that its answers have slope
/// one over the motions.
/// @throws std::invalid_argument if the equations cannot be solved with any ridge
/// @param differences H, points x motions; the nuisance's patterns are removed in place
/// @param motions M, motions x parameters; @param covariance C of the differences that are not the motions'
Predictor learnPredictor(Eigen::MatrixXf& differences, const Eigen::MatrixXf& motions,
                         const Eigen::MatrixXf& covariance, const Nuisance& nuisance);
}  // namespace xray_tracking
