#include "belief.h"

#include <limits>

#include <gtest/gtest.h>

#include "reliability.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
/// Neither believed beyond doubt nor not at all, so that every figure counts.
BeliefFigures middling()
{
  BeliefFigures figures;
  figures.expected_error_mm = 0.5;
  figures.least_similarity = 0.35;
  figures.pull_mm = 0.2;
  figures.here = 0.5;
  figures.rival = 0.38;
  figures.distinctness = 8.0;
  figures.loss_aside = 0.05;
  return figures;
}
}  // namespace

TEST(Belief, EveryFigureSpeaksAsItsMeaningHasIt)
{
  const double probability = probabilityOf(middling());
  const auto changed = [](double BeliefFigures::*figure, double value)
  {
    BeliefFigures figures = middling();
    figures.*figure = value;
    return probabilityOf(figures);
  };
  EXPECT_GT(probabilityOf(middling(), true), probability);
  EXPECT_LT(changed(&BeliefFigures::expected_error_mm, 1.0), probability);
  EXPECT_LT(changed(&BeliefFigures::pull_mm, 1.0), probability);
  EXPECT_GT(changed(&BeliefFigures::least_similarity, 0.7), probability);
  EXPECT_GT(changed(&BeliefFigures::distinctness, 14.0), probability);
  EXPECT_LT(changed(&BeliefFigures::rival, 0.48), probability);
  EXPECT_LT(changed(&BeliefFigures::loss_aside, -0.01), probability);
}

TEST(Belief, NothingIsBelievedOfFiguresThatAreNotThere)
{
  EXPECT_LT(probabilityOf(BeliefFigures()), 0.5);
  for (double BeliefFigures::*figure :
       { &BeliefFigures::expected_error_mm, &BeliefFigures::least_similarity, &BeliefFigures::pull_mm,
         &BeliefFigures::distinctness, &BeliefFigures::loss_aside })
  {
    BeliefFigures figures = middling();
    figures.*figure = std::numeric_limits<double>::quiet_NaN();
    EXPECT_EQ(probabilityOf(figures), 0.0);
  }
}

TEST(LeastKnown, MovesTheBoxByAMillimetreAlongWhatIsKnownLeast)
{
  const Eigen::AlignedBox3d box(Eigen::Vector3d(10.0, -20.0, 5.0), Eigen::Vector3d(30.0, 10.0, 85.0));
  RigidTransform pose = RigidTransform::Identity();
  pose.linear() = rotationFromVector(Eigen::Vector3d(0.3, -0.8, 0.5));
  pose.translation() = Eigen::Vector3d(100.0, -40.0, 7.0);
  // Of everything as much as moves the box by some hundredths of a millimetre.
  Eigen::Matrix<double, 6, 6> covariance = 1e-6 * Eigen::Matrix<double, 6, 6>::Identity();
  covariance.bottomRightCorner<3, 3>() *= 1e3;
  for (int unknown = 0; unknown < 6; ++unknown)
  {
    // Along or about an axis of the box.
    Twist direction = Twist::Zero();
    direction.segment<3>(unknown / 3 * 3) = pose.linear().col(unknown % 3);
    const double variance = unknown < 3 ? 1e-2 : 9.0;
    const Twist least = leastKnown(covariance + variance * direction * direction.transpose(), pose, box);
    EXPECT_NEAR(std::abs(least.normalized().dot(direction)), 1.0, 1e-2) << least.transpose();
    const RigidTransform moved = motionAbout(pose * box.center(), 0.01 * least) * pose;
    double sum = 0.0;
    for (int corner = 0; corner < 8; ++corner)
    {
      const Eigen::Vector3d point = box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner));
      sum += (moved * point - pose * point).squaredNorm();
    }
    EXPECT_NEAR(std::sqrt(sum / 8.0), 0.01, 1e-5);
  }
}
}  // namespace xray_tracking
