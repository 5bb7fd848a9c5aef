#include "reliability.h"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

namespace xray_tracking
{
namespace
{
constexpr int kTiles = 4;  // along either edge of a view's region
// The squared error is this much larger than the spread over the tiles, as all share the CT's noise and blur. Measured
// on exact X-rays of the phantom and on real anatomy, where it is alike.
constexpr double kCalibration = 2.5;

/// Normal equations of one tile of a view.
NormalEquations tileEquations(const ViewLevel& view, const ViewModel& model, const Eigen::VectorXf& weights,
                              const cv::Rect& tile)
{
  const auto unknowns = model.derivatives.cols();
  NormalEquations equations{ Eigen::MatrixXd::Zero(unknowns, unknowns), Eigen::VectorXd::Zero(unknowns) };
  for (int row = tile.y; row < tile.y + tile.height; ++row)
  {
    const int first = row * view.size().width + tile.x;
    const auto derivatives = model.derivatives.middleRows(first, tile.width);
    const Eigen::MatrixXf weighted = weights.segment(first, tile.width).asDiagonal() * derivatives;
    equations.information += (derivatives.transpose() * weighted).cast<double>();
    equations.gradient +=
        (weighted.transpose() * (view.measured().segment(first, tile.width) - model.image.segment(first, tile.width)))
            .cast<double>();
  }
  return equations;
}
}  // namespace

Eigen::Matrix<double, 6, 6> poseCovariance(const std::vector<ViewLevel>& views, const Linearisation& at)
{
  const NormalEquations whole = normalEquations(views, at);
  Eigen::Matrix<double, 6, 6> sum = Eigen::Matrix<double, 6, 6>::Zero();
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    const cv::Size& size = views[v].size();
    for (int tile = 0; tile < kTiles * kTiles; ++tile)
    {
      const cv::Point first(tile % kTiles * size.width / kTiles, tile / kTiles * size.height / kTiles);
      const cv::Point end((tile % kTiles + 1) * size.width / kTiles, (tile / kTiles + 1) * size.height / kTiles);
      const NormalEquations part = tileEquations(views[v], at.models[v], at.weights[v], cv::Rect(first, end));
      const Eigen::VectorXd step = (whole.information - part.information).ldlt().solve(whole.gradient - part.gradient);
      sum += step.head<6>() * step.head<6>().transpose();
    }
  }
  const double tiles = static_cast<double>(views.size()) * kTiles * kTiles;
  return kCalibration * (tiles - 1.0) / tiles * sum;
}

std::vector<ViewResidual> viewResiduals(const std::vector<ViewLevel>& views, const Linearisation& at,
                                        const Eigen::Vector3d& room_centre)
{
  std::vector<ViewResidual> residuals(views.size());
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    const Eigen::MatrixXf& derivatives = at.models[v].derivatives;
    const Eigen::VectorXf difference = views[v].measured() - at.models[v].image;
    const Eigen::MatrixXf weighted = at.weights[v].asDiagonal() * derivatives;
    Eigen::MatrixXd information = (derivatives.transpose() * weighted).cast<double>();
    // One view sees little of depth and of two rotations; these stay about where all views put them.
    information.diagonal() *= 1.05;
    const Eigen::VectorXd step = information.ldlt().solve((weighted.transpose() * difference).cast<double>().eval());
    const Eigen::Vector3d ray = (room_centre - views[v].geometry().source()).normalized();
    const Eigen::Vector3d translation = step.segment<3>(3);
    residuals[v].similarity = at.similarity[v];
    residuals[v].noise = difference.norm();
    residuals[v].pull_mm = (translation - ray * ray.dot(translation)).norm();
  }
  return residuals;
}
}  // namespace xray_tracking
