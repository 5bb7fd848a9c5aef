// A region that is lost and comes back, among neighbours that look like it.

#include "xray_tracking_hyperplane_tracker/recovering_tracker.h"

#include <gtest/gtest.h>

#include "spine_field.h"
#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"
#include "xray_tracking_hyperplane_tracker/template_registration.h"

namespace xray_tracking
{
namespace
{
constexpr double kNoise = 0.01;  // 10,000 quanta a pixel

template <typename Tracker, typename Options>
RecoveringTracker makeTracker(const Options& options = {})
{
  return RecoveringTracker(std::make_unique<Tracker>(options), {});
}

void expectAt(RecoveringTracker& tracker, const cv::Mat& image, const Eigen::Vector2d& displacement)
{
  const TrackResult& result = tracker.track(image);
  ASSERT_TRUE(result.found()) << displacement.transpose();
  EXPECT_LT((result.displacement - displacement).norm(), 0.3) << result.displacement.transpose();
}

const cv::Mat kNothing = cv::Mat::zeros(kSize, CV_16UC1);

TEST(RecoveringTracker, findsTheRegionAnywhereAfterALoss)
{
  const SpineField spine(0.5);
  auto tracker = makeTracker<HyperplaneTracker, HyperplaneTrackerOptions>();
  tracker.train(spine.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  std::uint32_t seed = 1;
  // By one or two vertebrae: a neighbour is where the region was last.
  for (const Eigen::Vector2d& displacement :
       { Eigen::Vector2d(4.0, kPeriod), { -15.0, -kPeriod - 1.3 }, { 10.5, -2.0 * kPeriod }, { 0.0, 0.4 } })
  {
    EXPECT_FALSE(tracker.track(kNothing).found());
    // Five exposures is what a recovery may take; it takes one.
    expectAt(tracker, spine.expose(displacement, kNoise, seed++), displacement);
    // What it goes on from is what it has proven, not what it has looked at last.
    const Eigen::Vector2d further = displacement + Eigen::Vector2d(2.0, -3.0);
    expectAt(tracker, spine.expose(further, kNoise, seed++), further);
  }
}

TEST(RecoveringTracker, followsNoTwinOnceLost)
{
  const SpineField twins(0.0);
  auto tracker = makeTracker<HyperplaneTracker, HyperplaneTrackerOptions>();
  tracker.train(twins.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  EXPECT_FALSE(tracker.track(kNothing).found());
  for (std::uint32_t seed = 1; seed < 6; ++seed)
  {
    EXPECT_FALSE(tracker.track(twins.expose({ 1.0, 2.0 }, kNoise, seed)).found());
  }
}

TEST(RecoveringTracker, servesOtherMethods)
{
  const cv::Rect region(70, 55, 100, 90);
  auto tracker = makeTracker<TemplateRegistration, TemplateRegistrationOptions>();
  tracker.train(expose({}), region);
  EXPECT_FALSE(tracker.track(cv::Mat::zeros(exposureSize(), CV_16UC1)).found());
  // Farther than its range.
  Exposure exposure;
  exposure.displacement = { -58.0, 35.0 };
  exposure.noise = 0.01;
  expectAt(tracker, expose(exposure), exposure.displacement);
}

TEST(RecoveringTracker, forgetsThatItWasLostWhenItLearnsAnew)
{
  const SpineField twins(0.0);
  const cv::Mat reference = twins.expose({ 0.0, 0.0 }, kNoise, 0);
  auto tracker = makeTracker<HyperplaneTracker, HyperplaneTrackerOptions>();
  tracker.train(reference, kRegion);
  EXPECT_FALSE(tracker.track(kNothing).found());
  tracker.train(reference, kRegion);
  expectAt(tracker, reference, { 0.0, 0.0 });
  tracker.reset();
  EXPECT_FALSE(tracker.trained());
}
}  // namespace
}  // namespace xray_tracking
