#pragma once

#include <Eigen/Core>

namespace xray_tracking
{
/// Covariance [px^2] that a view's track has because it was not exposed together with the others: the target may have
/// moved in any direction in between. To be added to the track's own.
/// @param jacobian of the view's projection at the target [px / mm]
/// @param speed standard deviation of the target's velocity along any axis [mm/s], >= 0
/// @param seconds between the exposures, either sign
inline Eigen::Matrix2d asynchronyCovariance(const Eigen::Matrix<double, 2, 3>& jacobian, double speed, double seconds)
{
  return (speed * seconds) * (speed * seconds) * jacobian * jacobian.transpose();
}
}  // namespace xray_tracking
