#include "xray_tracking_motion_estimation/observability.h"

#include <cmath>
#include <iomanip>
#include <limits>
#include <sstream>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
/// Less information than this share of the best direction's is none: a standard deviation a thousand times larger.
constexpr double kSeen = 1e-6;

// Nor is one that leaves more than this open for a pixel: rounding.
constexpr double kMaxTranslation = 1e5;  // mm
constexpr double kMaxRotation = 2.0 * M_PI;

void principalDeviations(const Eigen::Matrix3d& information, double max_deviation, Eigen::Matrix3d& directions,
                         Eigen::Vector3d& deviations)
{
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(information);
  directions = solver.eigenvectors();
  const double best = solver.eigenvalues()(2);
  for (int i = 0; i < 3; ++i)
  {
    const double value = solver.eigenvalues()(i);
    const bool seen = value > kSeen * best && value * max_deviation * max_deviation > 1.0;
    deviations(i) = seen ? 1.0 / std::sqrt(value) : std::numeric_limits<double>::infinity();
  }
}
}  // namespace

Observability observability(const std::vector<ProjectionGeometry>& views, const Eigen::Vector3d& target,
                            const TargetShape& shape, TrackModel model, double extent)
{
  requireOption(!views.empty(), "the number of views", views.size(), "one or more");
  requireOption(extent > 0.0 && std::isfinite(extent), "extent", extent, "a number > 0 mm");
  shape.validate();
  RigidTransform room_from_target = RigidTransform::Identity();
  room_from_target.translation() = target;
  Matrix6d information = Matrix6d::Zero();
  for (const ProjectionGeometry& view : views)
  {
    const double depth = view.depth(target);
    requireOption(depth > 0.0, "the target's distance from the source of " + view.name(), depth,
                  "a number > 0 mm: a target in front of the source");
    const RegionPatch patch =
        RegionPatch::make(view, room_from_target, Eigen::Vector3d::Zero(), shape, view.project(target));
    Matrix6d warp_by_motion;
    const Vector6d warp = patch.predict(view, target, Eigen::Matrix3d::Identity(), warp_by_motion);
    TrackParametersJacobian parameters_by_warp;
    nearestParameters(model, warp, patch.moments, parameters_by_warp);

    const double linear = depth / (extent * view.focalLength().mean());
    Vector6d variance;
    variance << 1.0, 1.0, Eigen::Vector4d::Constant(linear * linear);
    const Eigen::MatrixXd jacobian = parameters_by_warp * warp_by_motion;
    const Eigen::MatrixXd covariance = parameters_by_warp * variance.asDiagonal() * parameters_by_warp.transpose();
    information += jacobian.transpose() * covariance.llt().solve(jacobian);
  }
  Observability result;
  principalDeviations(information.topLeftCorner<3, 3>(), kMaxTranslation, result.translation_directions,
                      result.translation);
  principalDeviations(information.bottomRightCorner<3, 3>(), kMaxRotation, result.rotation_directions, result.rotation);
  return result;
}

std::string describe(const Observability& observability)
{
  std::ostringstream text;
  text << std::fixed << std::setprecision(2);
  const auto direction = [&](const Eigen::Vector3d& axis)
  { text << "[" << axis.x() << ", " << axis.y() << ", " << axis.z() << "]"; };
  text << "translation: worst along ";
  direction(observability.translation_directions.col(0));
  text << " with " << std::setprecision(3) << observability.translation(0) << " mm a pixel, condition "
       << std::setprecision(2) << observability.condition() << "\n";
  for (int i = 0; i < 3; ++i)
  {
    text << "rotation about ";
    direction(observability.rotation_directions.col(i));
    if (std::isfinite(observability.rotation(i)))
    {
      text << ": " << observability.rotation(i) * 180.0 / M_PI << " degrees a pixel\n";
    }
    else
    {
      text << ": not seen\n";
    }
  }
  return text.str();
}
}  // namespace xray_tracking
