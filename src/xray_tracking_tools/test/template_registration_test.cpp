#include "template_registration.h"

#include <cmath>
#include <functional>
#include <memory>
#include <random>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/recovering_tracker.h"
#include "xray_tracking_hyperplane_tracker/view_tracker.h"

namespace xray_tracking
{
namespace
{
using Similarity = TemplateRegistrationOptions::Similarity;

const cv::Rect kRegion(70, 55, 100, 90);

IntensityModel counts()
{
  IntensityModel intensity;
  intensity.offset = kOffset;
  return intensity;
}

class TemplateRegistrationTest : public testing::TestWithParam<Similarity>
{
protected:
  TemplateRegistration trained(const Exposure& reference = {}, MotionModel model = MotionModel::TRANSLATION)
  {
    TemplateRegistrationOptions options;
    options.similarity = GetParam();
    options.model = model;
    TemplateRegistration tracker(options, counts());
    tracker.train(expose(reference), kRegion);
    return tracker;
  }
  /// Interpolation and, for mutual information, the histogram's bins move the peak by a few hundredths [px].
  static constexpr double kPeak = 0.08;
};

/// An image in which everything is rotated about the region's centre and then displaced, in closed form.
cv::Mat exposeRotated(double angle, const Eigen::Vector2d& displacement)
{
  const Eigen::Vector2d centre(kRegion.x + (kRegion.width - 1) / 2.0, kRegion.y + (kRegion.height - 1) / 2.0);
  const Eigen::Rotation2Dd back(-angle);
  cv::Mat image(exposureSize(), CV_16UC1);
  for (int y = 0; y < image.rows; ++y)
  {
    for (int x = 0; x < image.cols; ++x)
    {
      const Eigen::Vector2d reference = centre + back * (Eigen::Vector2d(x, y) - centre - displacement);
      image.at<std::uint16_t>(y, x) =
          cv::saturate_cast<std::uint16_t>(kOffset + 20000.0 * std::exp(-targetField()(reference.x(), reference.y())));
    }
  }
  return image;
}

TEST_P(TemplateRegistrationTest, findsDisplacementsAndSaysHowWell)
{
  Exposure exposure;
  exposure.noise = 0.03;
  TemplateRegistration tracker = trained(exposure);
  const double bound = displacementBound(kRegion, kRegion.area(), exposure.noise);
  std::mt19937 random(2);
  std::uniform_real_distribution<double> place(-24.0, 24.0);
  for (int i = 0; i < 8; ++i)
  {
    exposure.displacement = { place(random), place(random) };
    ++exposure.seed;
    const TrackResult& result = tracker.trackFrom(expose(exposure), Eigen::Vector2d::Zero());
    EXPECT_EQ(result.status, TrackResult::Status::TRACKED);
    EXPECT_LT((result.displacement - exposure.displacement).norm(), kPeak + 3.0 * bound) << exposure.displacement;
    EXPECT_EQ(result.linear, Eigen::Matrix2d::Identity());
    // White noise of known size: the bound, but for what is lost with all that is slow.
    const double sd = std::sqrt(result.covariance.topLeftCorner<2, 2>().trace());
    EXPECT_GT(sd, 0.5 * bound);
    EXPECT_LT(sd, 3.0 * bound);
  }
}

TEST_P(TemplateRegistrationTest, findsRotations)
{
  TemplateRegistration tracker = trained({}, MotionModel::EUCLIDEAN);
  for (const double degrees : { -4.0, -1.5, 2.0, 4.0 })
  {
    const double angle = degrees * M_PI / 180.0;
    const Eigen::Vector2d displacement(1.5 * degrees, 3.0 - degrees);
    const TrackResult& result = tracker.track(exposeRotated(angle, displacement));
    EXPECT_EQ(result.status, TrackResult::Status::TRACKED);
    EXPECT_LT((result.displacement - displacement).norm(), kPeak);
    // What moves the region's corners by the same.
    EXPECT_NEAR(std::atan2(result.linear(1, 0), result.linear(0, 0)), angle, kPeak / 65.0);
    EXPECT_NEAR(result.linear.determinant(), 1.0, 1e-12);
    EXPECT_GT(result.covariance(3, 3), 0.0);
    EXPECT_EQ(tracker.trackFrom(exposeRotated(0.0, { 0.0, 0.0 }), { 0.0, 0.0 }).status, TrackResult::Status::TRACKED);
  }
}

TEST_P(TemplateRegistrationTest, ignoresGainContrastAndShading)
{
  TemplateRegistration tracker = trained();
  Exposure exposure;
  exposure.displacement = { 3.3, -2.4 };
  exposure.gain = 0.7;
  exposure.contrast = 1.3;
  exposure.shading = 0.3;
  const TrackResult& result = tracker.track(expose(exposure));
  EXPECT_EQ(result.status, TrackResult::Status::TRACKED);
  EXPECT_LT((result.displacement - exposure.displacement).norm(), kPeak);
}

TEST_P(TemplateRegistrationTest, isNotMisledByAPlateOverAQuarter)
{
  TemplateRegistration tracker = trained();
  Exposure exposure;
  exposure.displacement = { 4.4, -2.7 };
  cv::Mat image = expose(exposure);
  image(cv::Rect(kRegion.x + 30, kRegion.y + 10, kRegion.width / 2, kRegion.height / 2)) = 3000;
  const TrackResult& result = tracker.track(image);
  EXPECT_LT(result.quality, 0.85);
  // The plate's edges draw gradient correlation away, which must not pass for a result.
  if (GetParam() == Similarity::NORMALISED_MUTUAL_INFORMATION || result.found())
  {
    EXPECT_EQ(result.status, TrackResult::Status::DEGRADED);
    EXPECT_LT((result.displacement - exposure.displacement).norm(), 0.3);
  }
}

TEST_P(TemplateRegistrationTest, saysWhenTheRegionIsNotThereAndFindsItAgain)
{
  TemplateRegistration tracker = trained();
  Exposure exposure;
  exposure.displacement = { 10.0, 0.0 };
  ASSERT_TRUE(tracker.track(expose(exposure)).found());
  cv::Mat noise(exposureSize(), CV_16UC1);
  cv::RNG(5).fill(noise, cv::RNG::NORMAL, 5000, 300);
  for (const cv::Mat& image : { noise, cv::Mat(cv::Mat::zeros(exposureSize(), CV_16UC1)) })
  {
    const TrackResult& result = tracker.track(image);
    EXPECT_FALSE(result.found()) << result.correlation;
    EXPECT_TRUE(result.displacement.allFinite() && result.covariance.allFinite());
  }
  exposure.displacement = { 35.0, 5.0 };  // within the range of the last good place alone
  EXPECT_TRUE(tracker.track(expose(exposure)).found());
  EXPECT_LT((tracker.result().displacement - exposure.displacement).norm(), kPeak);
}

TEST_P(TemplateRegistrationTest, saysWhenTheRegionLeavesTheImage)
{
  TemplateRegistrationOptions options;
  options.similarity = GetParam();
  TemplateRegistration tracker(options, counts());
  tracker.train(expose({}), cv::Rect(10, 55, 100, 90));
  Exposure exposure;
  exposure.displacement = { -45.0, 0.0 };
  EXPECT_FALSE(tracker.trackFrom(expose(exposure), exposure.displacement).found());
  EXPECT_EQ(tracker.trackFrom(expose(exposure), { -400.0, 0.0 }).status, TrackResult::Status::OUT_OF_IMAGE);
}

TEST_P(TemplateRegistrationTest, refusesWhatItCannotUse)
{
  TemplateRegistrationOptions options;
  options.similarity = GetParam();
  TemplateRegistration tracker(options, counts());
  EXPECT_THROW(tracker.track(expose({})), std::logic_error);
  EXPECT_THROW(tracker.train(expose({}), cv::Rect(200, 55, 100, 90)), std::invalid_argument);
  EXPECT_THROW(tracker.train(expose({}), cv::Rect(20, 20, 15, 90)), std::invalid_argument);
  EXPECT_THROW(tracker.train(cv::Mat::ones(200, 240, CV_16UC1), kRegion), std::invalid_argument);
  EXPECT_FALSE(tracker.trained());
  tracker.train(expose({}), kRegion);
  EXPECT_THROW(tracker.track(cv::Mat::zeros(200, 200, CV_16UC1)), std::invalid_argument);
  EXPECT_EQ(tracker.region(), kRegion);
  tracker.reset();
  EXPECT_FALSE(tracker.trained());
}

INSTANTIATE_TEST_SUITE_P(Similarities, TemplateRegistrationTest,
                         testing::Values(Similarity::NORMALISED_MUTUAL_INFORMATION, Similarity::GRADIENT_CORRELATION),
                         [](const auto& tested) {
                           return tested.param == Similarity::GRADIENT_CORRELATION ? "GradientCorrelation"
                                                                                   : "MutualInformation";
                         });

// RegionTracker is a seam: what follows a region live works with another tracker than the one it was made for.
TEST(TemplateRegistration, isRecoveredFarBeyondItsRange)
{
  RecoveringTracker tracker(std::make_unique<TemplateRegistration>(TemplateRegistrationOptions()), {});
  tracker.train(expose({}), kRegion);
  EXPECT_FALSE(tracker.track(cv::Mat::zeros(exposureSize(), CV_16UC1)).found());
  Exposure exposure;
  exposure.displacement = { -58.0, 35.0 };
  exposure.noise = 0.01;
  const TrackResult& result = tracker.track(expose(exposure));
  ASSERT_TRUE(result.found());
  EXPECT_LT((result.displacement - exposure.displacement).norm(), 0.3) << result.displacement.transpose();
}

TEST(TemplateRegistration, saysThatItLearnsNothingAgain)
{
  ViewTracker tracker(std::make_unique<TemplateRegistration>(TemplateRegistrationOptions(), counts()), counts(), 1,
                      MotionModel::TRANSLATION, false, kRegion);
  Exposure exposure;
  exposure.noise = 0.01;
  const cv::Mat image = expose(exposure);
  EXPECT_EQ(tracker.answer(image, 1, Training{ Training::Kind::AGAIN, {} }).state, ViewAnswer::State::TRACKING);
  EXPECT_NE(tracker.learn(image).find("does not learn"), std::string::npos);
}

TEST(TemplateRegistrationOptions, namesWhatIsWrong)
{
  const auto message = [](const std::function<void(TemplateRegistrationOptions&)>& spoil)
  {
    TemplateRegistrationOptions options;
    spoil(options);
    try
    {
      options.validate();
    }
    catch (const std::invalid_argument& error)
    {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(message([](auto&) {}), "");
  EXPECT_EQ(message([](auto& o) { o.model = MotionModel::AFFINE; }).rfind("model is 6", 0), 0u);
  EXPECT_EQ(message([](auto& o) { o.bins = 3; }).rfind("bins is 3", 0), 0u);
  EXPECT_EQ(message([](auto& o) { o.range = NAN; }).rfind("range is nan", 0), 0u);
  EXPECT_EQ(message([](auto& o) { o.min_correlation = 1.5; }).rfind("min_correlation is 1.5", 0), 0u);
  EXPECT_EQ(message([](auto& o) { o.found_correlation = 0.2; }).rfind("found_correlation is 0.2", 0), 0u);
}
}  // namespace
}  // namespace xray_tracking
