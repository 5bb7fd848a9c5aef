#pragma once

#include "gauss_newton.h"

namespace xray_tracking
{
/// Covariance of the target's twist [rad, mm] at an optimum, the rest's marginalised, by the jackknife (Tukey 1958;
/// Efron and Stein, Annals of Statistics 9(3), 1981): how far the optimum goes, by one Gauss-Newton step, when one tile
/// of one view's region is left out. So noise and model errors count as they are, without a model of either.
Eigen::Matrix<double, 6, 6> poseCovariance(const std::vector<ViewLevel>& views, const Linearisation& at);

/// Every view's figures.
std::vector<ViewResidual> viewResiduals(const std::vector<ViewLevel>& views, const Linearisation& at,
                                        const Eigen::Vector3d& room_centre);
}  // namespace xray_tracking
