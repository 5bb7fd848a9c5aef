#include "predictor.h"

#include <algorithm>
#include <limits>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <Eigen/QR>

namespace xray_tracking
{
namespace
{
/// One motion in this many judges the ridge.
constexpr Eigen::Index kKeptOut = 5;
/// Ridges that are tried, upwards until the judged error grows; in units of the mean variance of the differences.
constexpr float kLeastRidge = 1e-5f;
constexpr float kLargestRidge = 1.f;
constexpr float kRidgeFactor = 10.f;
/// Answers of a smaller slope are not scaled up further.
constexpr float kLeastSlope = 0.5f;
}  // namespace

Nuisance::Nuisance(const Eigen::MatrixXd& patterns)
{
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(patterns);
  basis_ = (qr.householderQ() * Eigen::MatrixXd::Identity(patterns.rows(), patterns.cols())).cast<float>();
}

Eigen::MatrixXd shadingPatterns(const Points& points, const cv::Rect& region)
{
  const Eigen::ArrayXd x = (points.col(0).array().cast<double>() - region.x) * 2.0 / region.width - 1.0;
  const Eigen::ArrayXd y = (points.col(1).array().cast<double>() - region.y) * 2.0 / region.height - 1.0;
  Eigen::MatrixXd patterns(points.rows(), 6);
  patterns << Eigen::ArrayXd::Ones(points.rows()), x, y, x * x, x * y, y * y;
  return patterns;
}

Eigen::MatrixXf backgroundCovariance(const Points& points, const Nuisance& nuisance)
{
  const Eigen::Index n = points.rows();
  Eigen::MatrixXf covariance(n, n);
  for (Eigen::Index j = 0; j < n; ++j)
  {
    covariance.col(j) = -(points.rowwise() - points.row(j)).rowwise().norm();
  }
  // Only without the constant is -distance a covariance: of differences, of which the field is made.
  nuisance.removeFrom(covariance);
  covariance.transposeInPlace();
  nuisance.removeFrom(covariance);
  return covariance / covariance.diagonal().mean();
}

Predictor learnPredictor(Eigen::MatrixXf& differences, const Eigen::MatrixXf& motions,
                         const Eigen::MatrixXf& covariance, const Nuisance& nuisance)
{
  nuisance.removeFrom(differences);
  const Eigen::Index points = differences.rows();
  const Eigen::Index kept_out = differences.cols() / kKeptOut;
  const Eigen::Index used = differences.cols() - kept_out;
  const auto training = differences.leftCols(used);
  const auto judging = differences.rightCols(kept_out);
  Eigen::MatrixXf normal = Eigen::MatrixXf::Zero(points, points);
  normal.selfadjointView<Eigen::Lower>().rankUpdate(training, 1.f / static_cast<float>(used));
  const float unit = normal.diagonal().mean();
  normal += covariance;
  const Eigen::MatrixXf moments = training * motions.topRows(used) / static_cast<float>(used);

  Predictor best;
  float least = std::numeric_limits<float>::infinity();
  float before = 0.f;
  for (float ridge = kLeastRidge; ridge <= kLargestRidge; ridge *= kRidgeFactor)
  {
    normal.diagonal().array() += (ridge - before) * unit;
    before = ridge;
    const Eigen::LLT<Eigen::MatrixXf> factors(normal.selfadjointView<Eigen::Lower>());
    if (factors.info() != Eigen::Success)
    {
      continue;  // by rounding not positive definite: it takes a larger ridge
    }
    const Predictor candidate = factors.solve(moments);
    const float error =
        (judging.transpose() * candidate - motions.bottomRows(kept_out)).squaredNorm() / static_cast<float>(kept_out) +
        (candidate.transpose() * covariance.selfadjointView<Eigen::Lower>() * candidate).trace();
    if (!(error < least))
    {
      break;
    }
    least = error;
    best = candidate;
  }
  if (best.size() == 0)
  {
    throw std::invalid_argument("region: no predictor can be learnt from its image with these ranges");
  }
  nuisance.removeFrom(best);

  // Ridge and background shrink the answers; with slope one the iteration needs fewer steps and ends at the same place.
  // What hardly answers, such as a rotation beside large translations, stays small: blown up it would be noise.
  for (Eigen::Index k = 0; k < motions.cols(); ++k)
  {
    const float slope = motions.col(k).dot(differences.transpose() * best.col(k)) / motions.col(k).squaredNorm();
    best.col(k) /= std::max(slope, kLeastSlope);
  }
  return best;
}
}  // namespace xray_tracking
