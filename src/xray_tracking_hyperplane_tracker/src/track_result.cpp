#include <cmath>

#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
namespace
{
/// Standard deviation of a rotation that the tracker's covariance does not know of, of surroundings that move otherwise
/// [rad]: what motion_estimation's linear_floor_sigma, 0.005 for each of four numbers, makes of an angle.
constexpr double kRotationFloor = 0.0035;
/// So many standard deviations away from zero a rotation is one.
constexpr double kTold = 3.0;
}  // namespace

bool tellsRotation(const TrackResult& result)
{
  const Eigen::Matrix2d& l = result.linear;
  const double angle = std::atan2(l(1, 0) - l(0, 1), l(0, 0) + l(1, 1));
  const Eigen::Matrix<double, 6, 6>& c = result.covariance;
  const double variance = 0.25 * (c(3, 3) + c(4, 4) - 2.0 * c(3, 4));  // of (l21 - l12) / 2
  // Written so that NaN tells nothing.
  return std::abs(angle) > kTold * std::sqrt(variance + kRotationFloor * kRotationFloor);
}

TrackResult withoutLinearPart(TrackResult result)
{
  result.linear.setIdentity();
  result.covariance.rightCols<4>().setZero();
  result.covariance.bottomRows<4>().setZero();
  return result;
}
}  // namespace xray_tracking
