#include "warp.h"

#include <array>
#include <cmath>

namespace xray_tracking
{
const Eigen::Matrix2d& generator(int parameter)
{
  static const std::array<Eigen::Matrix2d, kMaxParameters> kGenerators = []
  {
    std::array<Eigen::Matrix2d, kMaxParameters> g;
    g[0].setZero();
    g[1].setZero();
    g[2] << 0, -1, 1, 0;
    g[3] << 1, 0, 0, 1;
    g[4] << 1, 0, 0, -1;
    g[5] << 0, 1, 1, 0;
    return g;
  }();
  return kGenerators[static_cast<std::size_t>(parameter)];
}

Warp Warp::exponential(const Parameters& parameters, double radius)
{
  const Eigen::Vector2d t = parameters.head<2>().cast<double>();
  if (parameters.size() == 2)
  {
    return { t, Eigen::Matrix2d::Identity() };
  }
  Eigen::Matrix2d g = Eigen::Matrix2d::Zero();
  for (Eigen::Index k = 2; k < parameters.size(); ++k)
  {
    g += static_cast<double>(parameters[k]) / radius * generator(static_cast<int>(k));
  }
  // Series of exp(G) and of (exp(G) - 1) / G. Steps are far below one: eight terms are exact.
  Eigen::Matrix2d power = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d linear = power;
  Eigen::Matrix2d mean = power;
  for (int n = 1; n <= 8; ++n)
  {
    power = power * g / n;
    linear += power;
    mean += power / (n + 1);
  }
  return { mean * t, linear };
}

Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxParameters> warpDerivative(const Warp& warp, int count,
                                                                              double radius)
{
  Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxParameters> derivative(6, count);
  derivative.setZero();
  derivative.topLeftCorner<2, 2>() = -warp.linear;
  for (int k = 2; k < count; ++k)
  {
    const Eigen::Matrix2d change = -warp.linear * generator(k) / radius;
    derivative.col(k).tail<4>() << change(0, 0), change(0, 1), change(1, 0), change(1, 1);
  }
  return derivative;
}
}  // namespace xray_tracking
