#include "predictor.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/QR>

namespace xray_tracking
{
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

Points learnPredictor(Eigen::MatrixXf& differences, const Points& motions, const Eigen::MatrixXf& prior,
                      const Nuisance& nuisance)
{
  nuisance.removeFrom(differences);
  const Eigen::Index n = differences.rows();
  Eigen::MatrixXf normal = Eigen::MatrixXf::Zero(n, n);
  normal.selfadjointView<Eigen::Lower>().rankUpdate(differences);
  normal += normal.diagonal().mean() * prior;
  Points predictor = normal.selfadjointView<Eigen::Lower>().llt().solve(differences * motions);
  nuisance.removeFrom(predictor);

  // Ridge and background shrink the answers; with slope one the iteration needs fewer steps and ends at the same place.
  const Eigen::Matrix2f slope =
      (motions.transpose() * motions).inverse() * (motions.transpose() * (differences.transpose() * predictor));
  return predictor * slope.inverse();
}
}  // namespace xray_tracking
