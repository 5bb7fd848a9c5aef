// A region that is lost and comes back, among neighbours that look like it.

#include "xray_tracking_hyperplane_tracker/recovering_tracker.h"

#include <gtest/gtest.h>

#include "spine_field.h"
#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
constexpr double kNoise = 0.01;  // 10,000 quanta a pixel

RecoveringTracker makeTracker(const HyperplaneTrackerOptions& options = {})
{
  return RecoveringTracker(std::make_unique<HyperplaneTracker>(options), {});
}

void expectAt(RecoveringTracker& tracker, const cv::Mat& image, const Eigen::Vector2d& displacement)
{
  const TrackResult& result = tracker.track(image);
  ASSERT_TRUE(result.found()) << displacement.transpose();
  EXPECT_LT((result.displacement - displacement).norm(), 0.3) << result.displacement.transpose();
}

const cv::Mat kNothing = cv::Mat::zeros(kSize, CV_16UC1);

/// The region with what is around it, twice.
cv::Mat exposeTwice(const SpineField& spine)
{
  cv::Mat image = spine.expose({ 0.0, 0.0 }, kNoise, 3);
  const cv::Rect around = kRegion + cv::Size(0, 40) - cv::Point(0, 20);
  image(around).copyTo(image(around + cv::Point(0, 130)));
  return image;
}

TEST(RecoveringTracker, findsTheRegionAnywhereAfterALoss)
{
  const SpineField spine(0.5);
  auto tracker = makeTracker();
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
  auto tracker = makeTracker();
  tracker.train(twins.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  EXPECT_FALSE(tracker.track(kNothing).found());
  for (std::uint32_t seed = 1; seed < 6; ++seed)
  {
    EXPECT_FALSE(tracker.track(twins.expose({ 1.0, 2.0 }, kNoise, seed)).found());
  }
}

TEST(RecoveringTracker, followsNoNeighbourWhileTheRegionIsOutside)
{
  const SpineField spine(1.0);
  auto tracker = makeTracker();
  tracker.train(spine.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  std::uint32_t seed = 1;
  for (const double outside : { -7.0, -5.0, 5.3, 6.5 })
  {
    expectAt(tracker, spine.expose({ 1.0, 2.0 }, kNoise, seed++), { 1.0, 2.0 });
    EXPECT_FALSE(tracker.track(kNothing).found());
    EXPECT_FALSE(tracker.track(spine.expose({ 0.0, outside * kPeriod }, kNoise, seed++)).found())
        << outside << " " << tracker.result().correlation;
  }
}

// What the template's own exposure leaves unexplained, nothing, says nothing of what others will.
TEST(RecoveringTracker, isFoundAgainThoughOnlyTheTemplatesExposureWasTracked)
{
  const SpineField spine(1.0);
  const cv::Mat reference = spine.expose({ 0.0, 0.0 }, kNoise, 0);
  auto tracker = makeTracker();
  tracker.train(reference, kRegion);
  for (int i = 0; i < 5; ++i)
  {
    expectAt(tracker, reference, { 0.0, 0.0 });
  }
  EXPECT_FALSE(tracker.track(kNothing).found());
  // Looks that have changed: four times the noise, which leaves more than a twentieth unexplained.
  expectAt(tracker, spine.expose({ 1.0, 2.0 }, 4.0 * kNoise, 1), { 1.0, 2.0 });
  EXPECT_LT(tracker.result().correlation, std::sqrt(1.0 - 0.05));
}

TEST(RecoveringTracker, isLostUntilItIsFoundByItsOwnThreshold)
{
  // The region in noise that lets it be followed, but not found again.
  const SpineField spine(2.0);
  const cv::Mat noisy = spine.expose({ 0.0, 0.0 }, 3.0 * kNoise, 1);
  auto probe = makeTracker();
  probe.train(spine.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  const double correlation = probe.track(noisy).correlation;
  HyperplaneTrackerOptions options;
  options.min_correlation = correlation - 0.1;
  options.found_correlation = correlation + 0.02;

  auto tracker = makeTracker(options);
  tracker.train(spine.expose({ 0.0, 0.0 }, kNoise, 0), kRegion);
  EXPECT_TRUE(tracker.track(noisy).found());
  EXPECT_FALSE(tracker.track(kNothing).found());
  EXPECT_FALSE(tracker.track(noisy).found());
  // Candidates that look alike, each good enough, prove nothing, now or later.
  EXPECT_FALSE(tracker.track(exposeTwice(spine)).found());
  EXPECT_FALSE(tracker.track(noisy).found());
  expectAt(tracker, spine.expose({ 1.0, 2.0 }, kNoise, 2), { 1.0, 2.0 });
}

TEST(RecoveringTracker, forgetsThatItWasLostWhenItLearnsAnew)
{
  const SpineField twins(0.0);
  const cv::Mat reference = twins.expose({ 0.0, 0.0 }, kNoise, 0);
  auto tracker = makeTracker();
  tracker.train(reference, kRegion);
  EXPECT_FALSE(tracker.track(kNothing).found());
  tracker.train(reference, kRegion);
  expectAt(tracker, reference, { 0.0, 0.0 });
  tracker.reset();
  EXPECT_FALSE(tracker.trained());
}
}  // namespace
}  // namespace xray_tracking
