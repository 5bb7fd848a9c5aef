#include <limits>
#include <stdexcept>

#include "scene.h"

namespace xray_tracking
{
namespace
{
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

void expectRefused(const Scene& scene, const MotionEstimationOptions& options, const std::string& name)
{
  try
  {
    scene.estimator(options);
    ADD_FAILURE() << "nothing thrown, expected a message about " << name;
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
  }
}

TEST(MissingViews, TwoThatAreLeftAreEnough)
{
  const Eigen::Vector3d motion(3.0, -4.0, 5.0);
  for (const EstimationMethod method : { EstimationMethod::LEAST_SQUARES, EstimationMethod::BACKPROJECTION })
  {
    // On the axis and mutually orthogonal: good enough a case for the paper's method, too.
    const Scene three{ { viewAt("a", 45 * kDegree), viewAt("b", -45 * kDegree), viewAt("c", 0.0) },
                       Eigen::Vector3d::Zero() };
    const MotionEstimator estimator = three.estimator(optionsFor(method));
    auto tracks = three.exactTracks(motion);
    tracks[2].reset();
    const MotionEstimate estimate = estimator.estimate(tracks);
    ASSERT_EQ(estimate.status, EstimateStatus::OK) << estimate.reason;
    EXPECT_LT((estimate.translation - motion).norm(),
              (method == EstimationMethod::LEAST_SQUARES ? 1e-6 : 5e-3) * motion.norm());
    EXPECT_EQ(estimate.degrees_of_freedom, 1);
    ASSERT_EQ(estimate.residuals.size(), 2u);
    EXPECT_EQ(estimate.residuals[1].view, 1u);
    // The same numbers as from an estimator that never had a third view.
    const Scene two{ { three.views[0], three.views[1] }, three.target };
    const MotionEstimate same = two.estimator(optionsFor(method)).estimate({ tracks[0], tracks[1] });
    EXPECT_TRUE(estimate.covariance.isApprox(same.covariance, 1e-9));
    EXPECT_LT((estimate.translation - same.translation).norm(), 1e-9);
  }
}

TEST(MissingViews, OneViewIsReportedAsUnobservable)
{
  const Scene scene{ { viewAt("a", 45 * kDegree), viewAt("b", -45 * kDegree), viewAt("c", 44 * kDegree) },
                     { 10.0, 5.0, 0.0 } };
  const MotionEstimator estimator = scene.estimator(MotionEstimationOptions());
  const auto expectUnobservable = [&](const Measurements& tracks, const std::string& name)
  {
    const MotionEstimate estimate = estimator.estimate(tracks);
    EXPECT_EQ(estimate.status, EstimateStatus::UNOBSERVABLE);
    EXPECT_NE(estimate.reason.find(name), std::string::npos) << estimate.reason;
    EXPECT_EQ(estimate.translation, Eigen::Vector3d::Zero());
    EXPECT_TRUE(estimate.residuals.empty());
  };
  const Measurements all = scene.exactTracks(Eigen::Vector3d(1.0, 2.0, 3.0), TrackModel::AFFINE);
  expectUnobservable({ std::nullopt, all[1], std::nullopt }, "b");
  expectUnobservable({ all[0], std::nullopt, all[2] }, "a c");
  expectUnobservable({ std::nullopt, std::nullopt, std::nullopt }, "no view");
}

TEST(BadInput, ParallelViewsAreRefused)
{
  const MotionEstimationOptions options;
  expectRefused({ { viewAt("left", 0.0), viewAt("right", 0.0) }, { 0, 0, 0 } }, options, "left right");
  expectRefused({ { viewAt("left", 0.0), viewAt("right", 4 * kDegree) }, { 0, 0, 0 } }, options, "min_view_angle");
  expectRefused({ { viewAt("left", 0.0), viewAt("right", 180 * kDegree) }, { 0, 0, 0 } }, options, "parallel");
  expectRefused({ { viewAt("left", 0.0) }, { 0, 0, 0 } }, options, "views");
  expectRefused({ cyberknife(), { 0, 0, 4000 } }, options, "detector_a");
  expectRefused({ cyberknife(), { kNaN, 0, 0 } }, options, "detector_a");
  // A third view in a different direction is enough.
  const Scene three{ { viewAt("a", 0.0), viewAt("b", 0.0), viewAt("c", 20 * kDegree) }, { 0, 0, 0 } };
  EXPECT_LT(relativeError(three, { 1, 2, 3 }, EstimationMethod::LEAST_SQUARES), 1e-6);
}

// Two sources beside each other and one panel's plane: the rays differ, but no panel sees motion along room z.
TEST(BadInput, BackprojectionOfParallelPanelsIsRefused)
{
  std::vector<DetectorDescription> views{ viewAt("left", 0.0), viewAt("right", 0.0) };
  views[0].source.x() -= 400.0;
  views[1].source.x() += 400.0;
  const Scene scene{ views, { 0, 0, 0 } };
  const MotionEstimate estimate = estimateExact(scene, { 1.0, 2.0, 3.0 }, EstimationMethod::BACKPROJECTION);
  EXPECT_EQ(estimate.status, EstimateStatus::INVALID);
  EXPECT_TRUE(estimate.translation.isZero());
  EXPECT_LT(relativeError(scene, { 1.0, 2.0, 3.0 }, EstimationMethod::LEAST_SQUARES), 1e-6);
}

TEST(BadInput, MeasurementsThatAreNoneAreRefused)
{
  const Scene scene{ cyberknife(), { 10.0, -15.0, 20.0 } };
  for (const EstimationMethod method : { EstimationMethod::LEAST_SQUARES, EstimationMethod::BACKPROJECTION })
  {
    const MotionEstimator estimator = scene.estimator(optionsFor(method));
    const auto refused = [&](const std::string& name, const auto& damage)
    {
      auto tracks = scene.exactTracks({ 1.0, 2.0, 3.0 });
      damage(*tracks[1]);
      const MotionEstimate estimate = estimator.estimate(tracks);
      EXPECT_EQ(estimate.status, EstimateStatus::INVALID);
      EXPECT_NE(estimate.reason.find(name), std::string::npos) << estimate.reason;
      EXPECT_EQ(estimate.translation, Eigen::Vector3d::Zero());
      EXPECT_EQ(estimate.chi_square, 0.0);
    };
    refused("detector_b: displacement", [](auto& view) { view.track.displacement.x() = kNaN; });
    refused("detector_b: displacement",
            [](auto& view) { view.track.displacement.y() = std::numeric_limits<double>::infinity(); });
    refused("detector_b: covariance", [](auto& view) { view.track.covariance(0, 1) = kNaN; });
    refused("detector_b: covariance", [](auto& view) { view.track.covariance(1, 1) = -0.1; });
    refused("detector_b: covariance",
            [](auto& view) { view.track.covariance.template topLeftCorner<2, 2>() << 1.0, 5.0, 5.0, 1.0; });
    refused("detector_b: covariance",
            [](auto& view) { view.track.covariance.template topLeftCorner<2, 2>() << 1.0, 0.5, 0.0, 1.0; });
    refused("detector_b: linear part", [](auto& view) { view.track.linear(0, 1) = kNaN; });
    refused("detector_b: linear part", [](auto& view) { view.track.linear(0, 0) = -1.0; });
    refused("detector_b: displacement", [](auto& view) { view.track.centre.x() = kNaN; });
    refused("detector_b: the target", [](auto& view) { view.room_from_patient.translation().z() += 1e5; });
    refused("sources", [](auto& view) { view.track.displacement.y() = 1e200; });
    EXPECT_THROW(estimator.estimate({}), std::invalid_argument);
  }
}

TEST(BadInput, OptionsNameTheKey)
{
  const Scene scene{ cyberknife(), { 0, 0, 0 } };
  const auto refused = [&](const std::string& key, double MotionEstimationOptions::*field, double value)
  {
    MotionEstimationOptions options;
    options.*field = value;
    expectRefused(scene, options, key);
  };
  for (const double value : { 0.0, -1.0, kNaN, std::numeric_limits<double>::infinity() })
  {
    refused("significance", &MotionEstimationOptions::significance, value);
    refused("linear_floor_sigma", &MotionEstimationOptions::linear_floor_sigma, value);
    refused("floor_sigma", &MotionEstimationOptions::floor_sigma, value);
    refused("rotation_sigma", &MotionEstimationOptions::rotation_sigma, value);
    refused("min_view_angle", &MotionEstimationOptions::min_view_angle, value);
  }
  refused("tissue_sigma", &MotionEstimationOptions::tissue_sigma, -0.1);
  refused("tissue_sigma", &MotionEstimationOptions::tissue_sigma, kNaN);
  refused("tissue_time", &MotionEstimationOptions::tissue_time, 0.0);
  refused("tissue_time", &MotionEstimationOptions::tissue_time, kNaN);
  refused("significance", &MotionEstimationOptions::significance, 1.0);
  refused("min_view_angle", &MotionEstimationOptions::min_view_angle, 2.0);
  EXPECT_THROW(estimationMethodFromName("Least_Squares"), std::invalid_argument);
  EXPECT_EQ(estimationMethodFromName("least_squares"), EstimationMethod::LEAST_SQUARES);
  EXPECT_EQ(estimationMethodFromName("backprojection"), EstimationMethod::BACKPROJECTION);
}
}  // namespace
}  // namespace xray_tracking
