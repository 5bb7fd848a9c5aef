#include "xray_tracking_motion_estimation/asynchrony.h"

#include <random>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
namespace
{
// Against where targets that move at random are projected to. A sample covariance of n values is off by sqrt(2 / n).
TEST(Asynchrony, IsWhatMotionInBetweenDoes)
{
  const ProjectionGeometry view = ProjectionGeometry::fromDescription({ "view",
                                                                        { 512, 512 },
                                                                        { 0.4, 0.4 },
                                                                        { 0.0, 0.0, -2600.0 },
                                                                        { -90.0, -110.0, 1200.0 },
                                                                        Eigen::Vector3d::UnitX(),
                                                                        Eigen::Vector3d::UnitY() });
  const Eigen::Vector3d target(20.0, -30.0, 40.0);
  const double speed = 15.0;
  const double late = -0.05;
  constexpr int kSamples = 20000;
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  Eigen::Matrix2d sampled = Eigen::Matrix2d::Zero();
  for (int i = 0; i < kSamples; ++i)
  {
    const Eigen::Vector3d velocity = speed * Eigen::Vector3d(normal(random), normal(random), normal(random));
    const Eigen::Vector2d shift = view.project(target + late * velocity) - view.project(target);
    sampled += shift * shift.transpose() / kSamples;
  }
  const Eigen::Matrix2d expected = asynchronyCovariance(view.projectionJacobian(target), speed, late);
  EXPECT_LT((sampled - expected).norm(), 0.03 * expected.norm());
}
}  // namespace
}  // namespace xray_tracking
