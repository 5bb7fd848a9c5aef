#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "synthetic_exposure.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kRegion(70, 55, 100, 90);

/// Of exposures without noise [px]: what sampling between pixels and the last step's tolerance may leave, and that
/// dense texture's finest part is taken for noise, as there is none else.
constexpr double kInterpolation = 0.01;

IntensityModel counts(double offset = kOffset)
{
  IntensityModel intensity;
  intensity.kind = IntensityModel::Kind::COUNTS;
  intensity.offset = offset;
  return intensity;
}

HyperplaneTracker trainedTracker(const Exposure& reference = {}, const HyperplaneTrackerOptions& options = {})
{
  HyperplaneTracker tracker(options, counts());
  tracker.train(expose(reference), kRegion);
  return tracker;
}

void expectFollows(HyperplaneTracker& tracker, const cv::Mat& image, const Eigen::Vector2d& truth, double tolerance)
{
  const TrackResult& result = tracker.track(image);
  EXPECT_EQ(result.status, TrackResult::Status::TRACKED) << "at " << truth.transpose();
  EXPECT_LT((result.displacement - truth).norm(), tolerance)
      << "found " << result.displacement.transpose() << ", truth " << truth.transpose();
}

std::string messageOf(const std::function<void()>& call)
{
  try
  {
    call();
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  ADD_FAILURE() << "expected std::invalid_argument";
  return "";
}

bool contains(const std::string& text, const std::string& part)
{
  return text.find(part) != std::string::npos;
}

/// A random walk within +-20 px with steps of up to 12 px a direction.
std::vector<Eigen::Vector2d> walk(int count)
{
  std::mt19937 random(11);
  std::uniform_real_distribution<double> step(-12.0, 12.0);
  std::vector<Eigen::Vector2d> places;
  Eigen::Vector2d place = Eigen::Vector2d::Zero();
  while (static_cast<int>(places.size()) < count)
  {
    place = (place + Eigen::Vector2d(step(random), step(random))).cwiseMax(-20.0).cwiseMin(20.0);
    places.push_back(place);
  }
  return places;
}

/// Follows a noisy walk; judges every frame. @param counts, type of the images
void followNoisyWalk(double counts_in_air, int type, double noise)
{
  HyperplaneTrackerOptions options;
  HyperplaneTracker tracker(options, counts(type == CV_16UC1 ? kOffset : 0.0));
  Exposure exposure;
  exposure.noise = noise;
  tracker.train(expose(exposure, counts_in_air, type), kRegion);
  // Both images' noise is in the bound. What shading, contrast and a background could also explain is given away: half
  // as much again as the bound.
  const double sd = 1.5 * displacementBound(kRegion, kRegion.area(), noise) + kInterpolation;
  double squares = 0.0;
  const std::vector<Eigen::Vector2d> places = walk(30);
  for (const Eigen::Vector2d& place : places)
  {
    exposure.displacement = place;
    ++exposure.seed;
    expectFollows(tracker, expose(exposure, counts_in_air, type), place, 3.5 * sd);
    const Eigen::Vector2d error = tracker.result().displacement - place;
    squares += error.squaredNorm();
  }
  EXPECT_LT(std::sqrt(squares / places.size()), sd);
}

TEST(HyperplaneTracker, followsSubpixelMotionIn16Bit)
{
  followNoisyWalk(20000.0, CV_16UC1, 0.03);
}

TEST(HyperplaneTracker, followsSubpixelMotionIn8Bit)
{
  followNoisyWalk(120.0, CV_8UC1, 0.03);
}

// Every pixel as three by three: their means are the image again, the displacement is three times as long.
TEST(HyperplaneTracker, followsTheSameInAFinerImage)
{
  for (const int type : { CV_16UC1, CV_8UC1 })
  {
    const double full = type == CV_16UC1 ? 20000.0 : 120.0;
    HyperplaneTrackerOptions options;
    options.model = MotionModel::EUCLIDEAN;
    const IntensityModel intensity = counts(type == CV_16UC1 ? kOffset : 0.0);
    HyperplaneTracker coarse(options, intensity);
    options.reduction = 3;
    HyperplaneTracker fine(options, intensity);
    const auto enlarged = [](const cv::Mat& image)
    {
      cv::Mat large;
      cv::resize(image, large, {}, 3.0, 3.0, cv::INTER_NEAREST);
      return large;
    };
    const cv::Rect large(3 * kRegion.x, 3 * kRegion.y, 3 * kRegion.width, 3 * kRegion.height);
    coarse.train(expose({}, full, type), kRegion);
    fine.train(enlarged(expose({}, full, type)), large);
    EXPECT_EQ(fine.region(), large);
    Exposure e;
    e.displacement = { 5.3, -7.1 };
    e.linear = Eigen::Rotation2Dd(0.03).toRotationMatrix();
    e.noise = 0.01;
    const TrackResult expected = coarse.track(expose(e, full, type));
    const TrackResult& found = fine.track(enlarged(expose(e, full, type)));
    EXPECT_EQ(found.status, TrackResult::Status::TRACKED);
    // 8-bit images' means have further digits, so that the bins of these are not rounded.
    EXPECT_LT((found.displacement - 3.0 * expected.displacement).norm(), 0.02) << found.displacement.transpose();
    EXPECT_LT((found.linear - expected.linear).norm(), 1e-4);
    EXPECT_NEAR(found.covariance(0, 0), 9.0 * expected.covariance(0, 0), 0.02 * found.covariance(0, 0));
    EXPECT_LT((fine.trackFrom(enlarged(expose(e, full, type)), 3.0 * e.displacement).displacement -
               3.0 * expected.displacement)
                  .norm(),
              0.1);
  }
}

// A region too small for the reduction is tracked in smaller squares: lengths stay those that were asked for.
TEST(HyperplaneTracker, reachesAsFarWhereTheRegionIsSmall)
{
  const auto enlarged = [](const cv::Mat& image)
  {
    cv::Mat large;
    cv::resize(image, large, {}, 2.0, 2.0, cv::INTER_NEAREST);
    return large;
  };
  // In the image twice as fine, squares of 10 px would be 20 by 18: it takes them of 5.
  HyperplaneTrackerOptions plain;
  HyperplaneTrackerOptions options;
  options.reduction = 10;
  options.ranges = { 8.0, 3.2, 1.0 };
  options.convergence = 0.01;
  options.max_predicted_sd = 0.15;
  plain.reduction = 5;
  plain.ranges = { 16.0, 6.4, 2.0 };
  plain.convergence = 0.02;
  plain.max_predicted_sd = 0.3;
  const cv::Rect region(2 * kRegion.x, 2 * kRegion.y, 2 * kRegion.width, 2 * kRegion.height);
  HyperplaneTracker asked(options, counts());
  HyperplaneTracker same(plain, counts());
  const cv::Mat reference = enlarged(expose({}));
  asked.train(reference, region);
  same.train(reference, region);
  Exposure e;
  e.noise = 0.01;
  for (const Eigen::Vector2d& place : walk(8))
  {
    e.displacement = place;
    ++e.seed;
    const cv::Mat image = enlarged(expose(e));
    const TrackResult expected = same.track(image);
    expectFollows(asked, image, 2.0 * place, 2.5);  // half a square
    EXPECT_LT((asked.result().displacement - expected.displacement).norm(), 1e-3);
  }
  // As far as the contrast is concerned, too.
  options.max_predicted_sd = 1e-6;
  EXPECT_TRUE(
      contains(messageOf([&] { HyperplaneTracker(options, counts()).train(reference, region); }), "at most 2e-06"));
}

TEST(TrackResult, tellsARotationFromItsError)
{
  TrackResult result;
  result.displacement = { 3.0, -2.0 };
  result.covariance.topLeftCorner<2, 2>() = 0.01 * Eigen::Matrix2d::Identity();
  const auto turned = [&result](double degrees, double sd)
  {
    result.linear = Eigen::Rotation2Dd(degrees * M_PI / 180.0).toRotationMatrix();
    const Eigen::Vector4d along(0.0, -1.0, 1.0, 0.0);  // d linear / d angle
    result.covariance.bottomRightCorner<4, 4>() = std::pow(sd * M_PI / 180.0, 2) * along * along.transpose();
    return tellsRotation(result);
  };
  // 0.2 degrees are its floor, three standard deviations are asked for.
  EXPECT_FALSE(turned(0.5, 0.0));
  EXPECT_TRUE(turned(0.7, 0.0));
  EXPECT_TRUE(turned(-2.0, 0.6));
  EXPECT_FALSE(turned(2.0, 0.7));
  EXPECT_FALSE(turned(std::nan(""), 0.0));
  const TrackResult translation = withoutLinearPart(result);
  EXPECT_EQ(translation.displacement, result.displacement);
  EXPECT_TRUE(translation.linear.isIdentity());
  EXPECT_EQ(translation.covariance.sum(), 0.02);
}

TEST(HyperplaneTracker, trainingExposureHasNoDisplacement)
{
  HyperplaneTracker tracker = trainedTracker();
  const TrackResult& result = tracker.track(expose({}));
  EXPECT_EQ(result.status, TrackResult::Status::TRACKED);
  // The template without noise, which is rounding to whole counts here, is not quite its image.
  EXPECT_LT(result.displacement.norm(), 1e-3);
  EXPECT_GT(result.correlation, 0.999);
  EXPECT_GT((result.covariance.topLeftCorner<2, 2>().determinant()), 0.0);
  EXPECT_EQ(result.linear, Eigen::Matrix2d::Identity());
}

TEST(HyperplaneTracker, capturesTwentyPixelsInEveryDirection)
{
  HyperplaneTracker tracker = trainedTracker();
  for (int i = 0; i < 16; ++i)
  {
    const double angle = i * M_PI / 8.0;
    Exposure exposure;
    exposure.displacement = 20.0 * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    tracker.track(expose({}));
    ASSERT_LT(tracker.result().displacement.norm(), kInterpolation);
    expectFollows(tracker, expose(exposure), exposure.displacement, kInterpolation);
  }
}

TEST(HyperplaneTracker, ignoresGainContrastAndShading)
{
  HyperplaneTracker tracker = trainedTracker();
  for (int i = 0; i < 12; ++i)
  {
    Exposure exposure;
    exposure.displacement = { 3.3 - 0.6 * i, 0.45 * i - 2.2 };
    exposure.gain = i % 2 == 0 ? 0.7 : 1.3;
    exposure.contrast = i % 3 == 0 ? 0.8 : 1.2;
    exposure.shading = i % 4 < 2 ? 0.3 : -0.3;
    expectFollows(tracker, expose(exposure), exposure.displacement, kInterpolation);
    EXPECT_GT(tracker.result().correlation, 0.99);
  }
}

TEST(HyperplaneTracker, usesAttenuationAsItIs)
{
  const auto attenuation = [](const Exposure& exposure)
  {
    cv::Mat image, values;
    expose(exposure).convertTo(values, CV_32F, 1.0, -kOffset);
    cv::log(values / 20000.0, values);
    values.convertTo(image, CV_16U, -10000.0, 30000.0);
    return image;
  };
  IntensityModel intensity;
  intensity.kind = IntensityModel::Kind::ATTENUATION;
  HyperplaneTracker tracker({}, intensity);
  tracker.train(attenuation({}), kRegion);
  for (const Eigen::Vector2d& place : walk(10))
  {
    Exposure exposure;
    exposure.displacement = place;
    expectFollows(tracker, attenuation(exposure), place, kInterpolation);
  }
}

TEST(HyperplaneTracker, followsTheSharpTargetUnderASmoothOverlay)
{
  // The overlay has about the target's contrast and makes 60 % of its motion: a tracker that follows the mixture errs
  // by pixels.
  double worst[2];
  for (const bool with_background : { true, false })
  {
    HyperplaneTrackerOptions options;
    options.background = with_background ? 1.0 : 0.0;
    Exposure exposure;
    exposure.overlay = 1.0;
    HyperplaneTracker tracker = trainedTracker(exposure, options);
    double& error = worst[with_background ? 0 : 1];
    error = 0.0;
    for (const Eigen::Vector2d& place : walk(20))
    {
      exposure.displacement = 0.5 * place;
      exposure.overlay_displacement = 0.3 * place;
      const TrackResult& result = tracker.track(expose(exposure));
      ASSERT_EQ(result.status, TrackResult::Status::TRACKED);
      error = std::max(error, (result.displacement - exposure.displacement).norm());
    }
  }
  RecordProperty("worst_px", std::to_string(worst[0]));
  RecordProperty("worst_without_background_px", std::to_string(worst[1]));
  EXPECT_LT(worst[0], 0.3);
  EXPECT_LT(worst[0], 0.5 * worst[1]);
}

TEST(HyperplaneTracker, saysWhenTheRegionLeavesTheImageAndFindsItAgain)
{
  HyperplaneTracker tracker({}, counts());
  const cv::Rect region(10, 55, 100, 90);
  tracker.train(expose({}), region);
  Exposure exposure;
  for (const double x : { -8.0, -16.0, -22.0 })  // up to 12 % of the points outside
  {
    exposure.displacement = { x, 1.5 };
    expectFollows(tracker, expose(exposure), exposure.displacement, 0.15);
  }
  exposure.displacement = { -45.0, 1.5 };
  const TrackResult& result = tracker.track(expose(exposure));
  EXPECT_NE(result.status, TrackResult::Status::TRACKED);
  EXPECT_TRUE(std::isfinite(result.correlation) && result.covariance.allFinite());
  exposure.displacement = { -10.0, 0.0 };
  expectFollows(tracker, expose(exposure), exposure.displacement, 0.15);
}

TEST(HyperplaneTracker, namesARegionThatIsFarOutside)
{
  HyperplaneTrackerOptions options;
  options.ranges = { 200.0 };
  HyperplaneTracker tracker(options, counts());
  const cv::Rect corner(0, 0, 60, 60);
  tracker.train(expose({}), corner);
  int outside = 0;
  for (const double x : { -60.0, -100.0, -140.0 })
  {
    Exposure exposure;
    exposure.displacement = { x, x };
    const TrackResult& result = tracker.track(expose(exposure));
    EXPECT_NE(result.status, TrackResult::Status::TRACKED);
    outside += result.status == TrackResult::Status::OUT_OF_IMAGE;
  }
  EXPECT_GT(outside, 0);
}

TEST(HyperplaneTracker, isLostInAnImageWithoutTheTarget)
{
  HyperplaneTracker tracker = trainedTracker();
  cv::Mat noise(exposureSize(), CV_16UC1);
  cv::RNG random(5);
  random.fill(noise, cv::RNG::NORMAL, 5000, 300);
  const cv::Mat black = cv::Mat::zeros(exposureSize(), CV_16UC1);
  const cv::Mat white(exposureSize(), CV_16UC1, cv::Scalar(65535));
  cv::Mat foreign;
  cv::flip(expose({}), foreign, -1);
  for (const cv::Mat& image : { black, white, noise, foreign })
  {
    const TrackResult& result = tracker.track(image);
    EXPECT_NE(result.status, TrackResult::Status::TRACKED) << "correlation " << result.correlation;
    EXPECT_TRUE(std::isfinite(result.correlation) && result.displacement.allFinite() && result.covariance.allFinite());
    expectFollows(tracker, expose({}), Eigen::Vector2d::Zero(), kInterpolation);
  }
}

TEST(HyperplaneTracker, predictorsAloneDoNotTakeAnythingElseForTheTarget)
{
  HyperplaneTrackerOptions options;
  options.whole_region = false;
  HyperplaneTracker tracker = trainedTracker({}, options);
  cv::Mat foreign;
  for (std::uint32_t seed = 1; seed < 5; ++seed)
  {
    for (const double contrast : { -1.0, -0.5 })
    {
      Exposure negative;
      negative.contrast = contrast;
      negative.noise = 0.05;
      negative.seed = seed;
      const cv::Mat image = expose(negative);
      EXPECT_FALSE(tracker.track(image).found()) << contrast << ", correlation " << tracker.result().correlation;
      cv::flip(image, foreign, -1);
      EXPECT_FALSE(tracker.track(foreign).found()) << contrast << ", correlation " << tracker.result().correlation;
    }
    expectFollows(tracker, expose({}), Eigen::Vector2d::Zero(), kInterpolation);
  }
}

TEST(HyperplaneTracker, isFoundAgainOnlyWellAboveTheThreshold)
{
  // Noise of this size lowers the correlation to between the two thresholds.
  Exposure noisy;
  noisy.noise = 0.12;
  HyperplaneTracker probe = trainedTracker();
  const double correlation = probe.track(expose(noisy)).correlation;
  HyperplaneTrackerOptions options;
  options.min_correlation = correlation - 0.1;
  options.found_correlation = correlation + 0.1;
  ASSERT_LT(options.found_correlation, 0.99);

  HyperplaneTracker tracker = trainedTracker({}, options);
  EXPECT_EQ(tracker.track(expose(noisy)).status, TrackResult::Status::TRACKED);
  EXPECT_FALSE(tracker.track(cv::Mat::zeros(exposureSize(), CV_16UC1)).found());
  EXPECT_EQ(tracker.track(expose(noisy)).status, TrackResult::Status::LOW_CORRELATION);
  EXPECT_EQ(tracker.track(expose({})).status, TrackResult::Status::TRACKED);
  EXPECT_EQ(tracker.track(expose(noisy)).status, TrackResult::Status::TRACKED);
}

TEST(HyperplaneTracker, refusesRegionsWithoutContrast)
{
  HyperplaneTracker tracker({}, counts());
  cv::Mat noise(exposureSize(), CV_16UC1);
  cv::RNG random(5);
  random.fill(noise, cv::RNG::NORMAL, 5000, 300);
  cv::Mat stripes(exposureSize(), CV_16UC1), ramp(exposureSize(), CV_16UC1);
  for (int y = 0; y < stripes.rows; ++y)
  {
    for (int x = 0; x < stripes.cols; ++x)
    {
      stripes.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(8000 + 4000 * std::sin(0.4 * x));
      ramp.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(kOffset + 5000 * std::exp(0.004 * x + 0.003 * y));
    }
  }
  const cv::Mat constant(exposureSize(), CV_16UC1, cv::Scalar(5000));
  const std::vector<std::pair<std::string, cv::Mat>> images = {
    { "constant", constant }, { "noise", noise }, { "stripes", stripes }, { "ramp", ramp }
  };
  for (const auto& [name, image] : images)
  {
    SCOPED_TRACE(name);
    const std::string message = messageOf([&, &image = image] { tracker.train(image, kRegion); });
    EXPECT_TRUE(contains(message, "100 x 90 at (70, 55)")) << message;
    EXPECT_TRUE(contains(message, "too little contrast")) << message;
    EXPECT_TRUE(contains(message, "max_predicted_sd")) << message;
    EXPECT_FALSE(tracker.trained());
  }
}

TEST(HyperplaneTracker, refusesBadRegionsAndImagesAndKeepsTheTemplate)
{
  HyperplaneTracker tracker = trainedTracker();
  const cv::Mat image = expose({});
  for (const cv::Rect& region : { cv::Rect(-1, 20, 100, 90), cv::Rect(200, 20, 41, 90), cv::Rect(500, 500, 50, 50),
                                  cv::Rect(20, 20, 15, 90), cv::Rect(20, 20, 0, 0), cv::Rect(20, 20, -50, 50) })
  {
    const std::string message = messageOf([&] { tracker.train(image, region); });
    EXPECT_TRUE(contains(message, std::to_string(region.width) + " x " + std::to_string(region.height))) << message;
    EXPECT_TRUE(contains(message, "240 x 200")) << message;
  }
  EXPECT_TRUE(contains(messageOf([&] { tracker.train(cv::Mat(), kRegion); }), "image"));
  EXPECT_TRUE(contains(messageOf([&] { tracker.train(cv::Mat(200, 240, CV_8UC3), kRegion); }), "one channel"));

  const std::string size = messageOf([&] { tracker.track(cv::Mat::zeros(100, 120, CV_16UC1)); });
  EXPECT_TRUE(contains(size, "120 x 100 mono16") && contains(size, "240 x 200 mono16")) << size;
  const std::string type = messageOf([&] { tracker.track(cv::Mat::zeros(200, 240, CV_8UC1)); });
  EXPECT_TRUE(contains(type, "mono8") && contains(type, "mono16")) << type;
  expectFollows(tracker, image, Eigen::Vector2d::Zero(), kInterpolation);

  tracker.reset();
  EXPECT_FALSE(tracker.trained());
  EXPECT_THROW(tracker.track(image), std::logic_error);
}

TEST(HyperplaneTracker, isTheSameForTheSameSeed)
{
  Exposure exposure;
  exposure.displacement = { 4.3, -2.6 };
  exposure.noise = 0.03;
  const cv::Mat image = expose(exposure);
  HyperplaneTrackerOptions other;
  other.seed = 2;
  const Eigen::Vector2d first = trainedTracker().track(image).displacement;
  EXPECT_EQ(first, trainedTracker().track(image).displacement);
  EXPECT_NE(first, trainedTracker({}, other).track(image).displacement);
}

TEST(HyperplaneTrackerOptions, namesTheOptionThatIsWrong)
{
  using Options = HyperplaneTrackerOptions;
  const std::vector<std::pair<std::string, std::function<void(Options&)>>> faults = {
    { "points is 3", [](Options& o) { o.points = 3; } },
    { "ranges is empty", [](Options& o) { o.ranges.clear(); } },
    { "ranges is 8",
      [](Options& o) {
        o.ranges = { 4.0, 8.0 };
      } },
    { "ranges is nan", [](Options& o) { o.ranges = { std::nan("") }; } },
    { "ranges is 2e+09", [](Options& o) { o.ranges = { 2e9 }; } },
    { "training_motions is 0", [](Options& o) { o.training_motions = 0; } },
    { "points (with training_motions 800) is 20000", [](Options& o) { o.points = 20000; } },
    { "points (with training_motions 100000) is 2500",
      [](Options& o)
      {
        o.points = 2500;
        o.training_motions = 100000;
      } },
    { "bin is 0", [](Options& o) { o.bin = 0; } },
    { "rotation_range is 90", [](Options& o) { o.rotation_range = 90.0; } },
    { "scale_range is 1", [](Options& o) { o.scale_range = 1.0; } },
    { "background is 1e+300", [](Options& o) { o.background = 1e300; } },
    { "background is nan", [](Options& o) { o.background = std::nan(""); } },
    { "max_iterations is 2000", [](Options& o) { o.max_iterations = 2000; } },
    { "rotation_range is 0", [](Options& o) { o.rotation_range = 0.0; } },
    { "scale_range is nan", [](Options& o) { o.scale_range = std::nan(""); } },
    { "good_quality is 2", [](Options& o) { o.good_quality = 2.0; } },
    { "background is -1", [](Options& o) { o.background = -1.0; } },
    { "max_iterations is 0", [](Options& o) { o.max_iterations = 0; } },
    { "convergence is 0", [](Options& o) { o.convergence = 0.0; } },
    { "min_correlation is 1.5", [](Options& o) { o.min_correlation = 1.5; } },
    { "found_correlation is 0.1", [](Options& o) { o.found_correlation = 0.1; } },
    { "max_predicted_sd is inf", [](Options& o) { o.max_predicted_sd = INFINITY; } },
  };
  EXPECT_NO_THROW(Options().validate());
  Options large;
  large.points = 2000;
  large.training_motions = 100000;
  EXPECT_NO_THROW(large.validate());
  for (const auto& [expected, spoil] : faults)
  {
    Options options;
    spoil(options);
    const std::string message = messageOf([&options = options] { options.validate(); });
    EXPECT_TRUE(contains(message, expected)) << message << " lacks " << expected;
    EXPECT_THROW(HyperplaneTracker{ options }, std::invalid_argument);
  }
}
}  // namespace
}  // namespace xray_tracking
