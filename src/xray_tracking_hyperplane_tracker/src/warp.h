#pragma once

#include <Eigen/Core>

#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
constexpr int kMaxParameters = 6;
/// Parameters of a motion [px]: translation along x and y, rotation, scale, stretch of x against y, shear; a motion
/// model has the first ones. Those after the translation are multiplied by the region's radius, so that a parameter of
/// 1 moves a point in the region by about a pixel whichever it is.
using Parameters = Eigen::Matrix<float, Eigen::Dynamic, 1, 0, kMaxParameters, 1>;

template <typename Scalar>
using ParameterSquare = Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxParameters, kMaxParameters>;
using ParameterMatrix = ParameterSquare<float>;
using ParameterCovariance = ParameterSquare<double>;

/// Affine motion of points about a fixed centre: x -> centre + translation + linear (x - centre).
struct Warp
{
  Eigen::Vector2d translation = Eigen::Vector2d::Zero();
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();

  /// The warp that applies `first` and then this one.
  Warp after(const Warp& first) const { return { translation + linear * first.translation, linear * first.linear }; }
  /// The one-parameter group's element: exp(sum of parameters times generators). @param radius the region's [px]
  static Warp exponential(const Parameters& parameters, double radius);
};

/// The generators' linear parts (without 1 / radius), in the order of Parameters; zero for translations.
const Eigen::Matrix2d& generator(int parameter);

/// Derivative of (translation, linear 11, 12, 21, 22) of warp o exponential(-m) by the m of `count` parameters, at 0.
Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxParameters> warpDerivative(const Warp& warp, int count,
                                                                              double radius);
}  // namespace xray_tracking
