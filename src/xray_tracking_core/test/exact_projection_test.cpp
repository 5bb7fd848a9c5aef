#include "xray_tracking_core/projection/exact_projection.h"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "drr_samples.h"

namespace xray_tracking
{
namespace
{
TEST(ExactProjectionTest, CuboidsOfConstantValueGiveTheChord)
{
  const Eigen::Vector3i size(20, 30, 40);
  const Eigen::Vector3d spacing(1.0, 0.8, 1.5);
  const ScalarVolume volume = fill(makeGrid(size, spacing), [](const Eigen::Vector3d&) { return 1.0; });
  const Eigen::Vector3d half = 0.5 * spacing.cwiseProduct(size.cast<double>());
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int n = 0; n < 200; ++n)
  {
    const Eigen::Vector3d through =
        half.cwiseProduct(Eigen::Vector3d(unit(generator), unit(generator), unit(generator)));
    Ray ray;
    ray.direction = Eigen::Vector3d(unit(generator), unit(generator), n % 3 ? unit(generator) : 0.0).normalized();
    ray.source = through - 200.0 * ray.direction;
    double enter = 0.0;
    double exit = 1e9;
    for (int axis = 0; axis < 3; ++axis)
    {
      if (ray.direction[axis] != 0.0)
      {
        const double a = (-half[axis] - ray.source[axis]) / ray.direction[axis];
        const double b = (half[axis] - ray.source[axis]) / ray.direction[axis];
        enter = std::max(enter, std::min(a, b));
        exit = std::min(exit, std::max(a, b));
      }
    }
    EXPECT_NEAR(integrateCuboids(volume, ray), exit - enter, 1e-9);
  }
}

TEST(ExactProjectionTest, CuboidsStartAtTheSource)
{
  const ScalarVolume volume = fill(makeGrid({ 11, 11, 11 }, { 1, 1, 1 }), [](const Eigen::Vector3d&) { return 1.0; });
  EXPECT_NEAR(integrateCuboids(volume, { { 0.1, 0.2, 0.3 }, { 0, 0, 1 } }), 5.2, 1e-12);
  EXPECT_NEAR(integrateTrilinear(volume, { { 0.1, 0.2, 4.0 }, { 0, 0, 1 } }), 1.5, 1e-12);
  EXPECT_EQ(integrateCuboids(volume, { { 0.1, 0.2, 7.0 }, { 0, 0, 1 } }), 0.0);
}

TEST(ExactProjectionTest, TrilinearOfALinearFieldIsItsIntegral)
{
  // Interpolation reproduces linear fields; the ray stays inside along a chord between two points.
  const VolumeGrid grid = makeGrid({ 41, 41, 41 }, { 1.0, 1.2, 0.9 });
  const Eigen::Vector3d slope(0.3, -0.2, 0.5);
  const ScalarVolume volume = fill(grid, [&](const Eigen::Vector3d& p) { return 50.0 + slope.dot(p); });
  // From an inner point on through the border, where it falls to zero over one voxel; the difference of two sources on
  // one ray is the integral between them.
  const Eigen::Vector3d direction = Eigen::Vector3d(0.5, 0.6, -0.4).normalized();
  const Eigen::Vector3d from(-7.0, -5.0, 3.0);
  const double length = 9.7;
  const double integral = integrateTrilinear(volume, { from, direction }) -
                          integrateTrilinear(volume, { from + length * direction, direction });
  // Values are stored as floats: 50 * 2^-24 each.
  EXPECT_NEAR(integral, length * (50.0 + slope.dot(from + 0.5 * length * direction)), 1e-4);
}

TEST(ExactProjectionTest, TrilinearOfABlobIsNearItsClosedForm)
{
  const double sigma = 6.0;
  const ScalarVolume volume = fill(makeGrid({ 81, 81, 81 }, { 1, 1, 1 }),
                                   [&](const Eigen::Vector3d& p) {
                                     return blob(p, { 0, 0, 0 }, sigma);
                                   });
  const Eigen::Vector3d direction = Eigen::Vector3d(0.3, 0.5, -0.8).normalized();
  const Eigen::Vector3d nearest = 4.0 * direction.cross(Eigen::Vector3d::UnitX()).normalized();
  const double exact = sigma * std::sqrt(2.0 * M_PI) * std::exp(-0.5 * 16.0 / (sigma * sigma));
  // Linear interpolation adds variance 1/6 voxel^2 an axis: 1.2 % of the peak's cross section.
  EXPECT_NEAR(integrateTrilinear(volume, { nearest - 300.0 * direction, direction }), exact, 0.012 * exact);
}
}  // namespace
}  // namespace xray_tracking
