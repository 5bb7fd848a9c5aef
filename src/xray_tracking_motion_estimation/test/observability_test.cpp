#include "xray_tracking_motion_estimation/observability.h"

#include <cstdio>

#include "scene.h"

namespace xray_tracking
{
namespace
{
const TargetShape kBall = TargetShape::isotropic(Eigen::Vector3d::Zero());

TEST(Observability, OfTheCyberknifeByHand)
{
  const Eigen::Vector3d isocentre = Eigen::Vector3d::Zero();
  const Observability result = observability(geometriesOf(cyberknife()), isocentre, kBall, TrackModel::EUCLIDEAN, 25.0);
  std::printf("%s", describe(result).c_str());
  // A pixel is 0.4 mm * 2600 / 3800; the shared axis has two of them to average.
  const double pixel = 0.4 * kSourceToIsocentre / kSourceToDetector;
  EXPECT_NEAR(result.translation(0), pixel, 1e-9);
  EXPECT_NEAR(result.translation(2), pixel / std::sqrt(2.0), 1e-9);
  EXPECT_NEAR(result.condition(), std::sqrt(2.0), 1e-9);
  EXPECT_NEAR(std::abs(result.translation_directions.col(2).x()), 1.0, 1e-9);
  // About the shared axis nothing turns in either plane; an angle is the mean of two numbers of a pixel at 25 mm.
  EXPECT_EQ(result.rotation(0), std::numeric_limits<double>::infinity());
  EXPECT_NEAR(std::abs(result.rotation_directions.col(0).x()), 1.0, 1e-9);
  EXPECT_NEAR(result.rotation(1), pixel / 25.0 / std::sqrt(2.0), 1e-9);
  EXPECT_NEAR(result.rotation(2), pixel / 25.0 / std::sqrt(2.0), 1e-9);
  EXPECT_NE(describe(result).find("not seen"), std::string::npos);

  const Observability still =
      observability(geometriesOf(cyberknife()), isocentre, kBall, TrackModel::TRANSLATION, 25.0);
  EXPECT_EQ(still.rotation(2), std::numeric_limits<double>::infinity());
}

TEST(Observability, OfObliqueViewsByHand)
{
  const double pixel = 0.4 * kSourceToIsocentre / kSourceToDetector;
  for (const double apart : { 90.0, 45.0, 10.0 })
  {
    const Observability result = observability(geometriesOf({ viewAt("a", 0.0), viewAt("b", apart * kDegree) }),
                                               Eigen::Vector3d::Zero(), kBall, TrackModel::TRANSLATION, 25.0);
    // In the plane of both rays: sum of two projectors whose axes are `apart`, eigenvalues 1 +- cos.
    EXPECT_NEAR(result.translation(0), pixel / std::sqrt(1.0 - std::abs(std::cos(apart * kDegree))), 1e-9);
    EXPECT_NEAR(result.translation(2), pixel / std::sqrt(1.0 + std::max(1.0, std::abs(std::cos(apart * kDegree)))),
                1e-9);
  }
  // A single view does not see the direction of its ray; an affine one sees it by its scale, at the target's distance
  // times the error of the scale: the mean of two numbers of a pixel at 25 mm.
  const std::vector<ProjectionGeometry> one = geometriesOf({ viewAt("a", 0.0) });
  EXPECT_EQ(observability(one, Eigen::Vector3d::Zero(), kBall, TrackModel::TRANSLATION, 25.0).translation(0),
            std::numeric_limits<double>::infinity());
  EXPECT_NEAR(observability(one, Eigen::Vector3d::Zero(), kBall, TrackModel::AFFINE, 25.0).translation(0),
              kSourceToIsocentre * pixel / 25.0 / std::sqrt(2.0), 1e-6);
}

// Before treatment it predicts what the estimates will scatter by.
TEST(Observability, PredictsTheSpreadOfEstimates)
{
  constexpr int kTrials = 2000;
  for (const auto& views : { cyberknife(), { viewAt("a", 0.0), viewAt("b", 40 * kDegree, 20 * kDegree) } })
  {
    Random random;
    const Scene scene{ views, { 20.0, -10.0, 15.0 } };
    const Observability predicted =
        observability(geometriesOf(views), scene.target, kBall, TrackModel::TRANSLATION, 25.0);
    const MotionEstimator estimator = scene.estimator(MotionEstimationOptions());
    Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
    for (int trial = 0; trial < kTrials; ++trial)
    {
      auto tracks = scene.exactTracks(Eigen::Vector3d::Zero());
      for (auto& measurement : tracks)
      {
        measurement->track.displacement += random.normals(2);
      }
      const Eigen::Vector3d error = estimator.estimate(tracks).translation;
      scatter += error * error.transpose() / kTrials;
    }
    for (int i = 0; i < 3; ++i)
    {
      const Eigen::Vector3d direction = predicted.translation_directions.col(i);
      // 1 / sqrt(2 n) is the standard deviation of a standard deviation; three of them.
      EXPECT_NEAR(std::sqrt(direction.dot(scatter * direction)) / predicted.translation(i), 1.0,
                  3.0 / std::sqrt(2.0 * kTrials));
    }
  }
}

TEST(Observability, RefusesBadInput)
{
  const auto views = geometriesOf(cyberknife());
  const Eigen::Vector3d isocentre = Eigen::Vector3d::Zero();
  EXPECT_THROW(observability({}, isocentre, kBall, TrackModel::AFFINE, 25.0), std::invalid_argument);
  EXPECT_THROW(observability(views, isocentre, kBall, TrackModel::AFFINE, 0.0), std::invalid_argument);
  EXPECT_THROW(observability(views, { 0.0, 0.0, 5000.0 }, kBall, TrackModel::AFFINE, 25.0), std::invalid_argument);
  EXPECT_THROW(TargetShape::fromPoints({ { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 } }), std::invalid_argument);
  EXPECT_THROW(TargetShape::fromPoints({}), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
