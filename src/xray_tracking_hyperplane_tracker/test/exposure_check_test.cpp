// What does not move with the patient must not hold a region in its place.

#include "xray_tracking_hyperplane_tracker/exposure_check.h"

#include <algorithm>
#include <functional>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kRegion(70, 55, 100, 90);
const IntensityModel kCounts{ IntensityModel::Kind::COUNTS, kOffset, {} };

cv::Mat exposeAt(const Eigen::Vector2d& displacement, std::uint32_t seed)
{
  Exposure exposure;
  exposure.displacement = displacement;
  exposure.noise = 0.01;
  exposure.seed = seed;
  return expose(exposure);
}

/// What does something to every exposure of a detector.
using Detector = std::function<void(cv::Mat& image)>;

/// The largest error of a region that moves by up to 16 px behind a detector's flaw [px]. @param checked as the node
/// does
double largestError(const Detector& flaw, bool checked)
{
  ExposureCheck check(kCounts);
  HyperplaneTracker tracker({}, kCounts);
  cv::Mat first = exposeAt({ 0.0, 0.0 }, 1);
  flaw(first);
  EXPECT_EQ("", check.look(first, 1));
  const cv::Rect region = checked ? check.learn(first, kRegion) : kRegion;
  tracker.train(checked ? check.repaired(first) : first, region);
  double largest = 0.0;
  for (int i = 1; i <= 8; ++i)
  {
    const Eigen::Vector2d displacement(1.5 * i, -1.3 * i);
    cv::Mat image = exposeAt(displacement, 1 + static_cast<std::uint32_t>(i));
    flaw(image);
    EXPECT_EQ("", check.look(image, 1 + i));
    const TrackResult& result = tracker.track(checked ? check.repaired(image) : image);
    if (checked)
    {
      EXPECT_TRUE(result.found()) << displacement.transpose();
    }
    largest = std::max(largest, result.found() ? (result.displacement - displacement).norm() : 0.0);
  }
  return largest;
}

TEST(ExposureCheck, stuckPixelsHoldNoRegion)
{
  cv::Mat stuck(exposureSize(), CV_8UC1, cv::Scalar(0));
  cv::RNG random(3);
  for (int n = 0; n < 0.01 * stuck.total(); ++n)
  {
    stuck.at<std::uint8_t>(random.uniform(0, stuck.rows), random.uniform(0, stuck.cols)) =
        static_cast<std::uint8_t>(1 + n % 2);
  }
  stuck.row(100) = 1;
  stuck.col(111) = 2;
  const Detector flaw = [&stuck](cv::Mat& image)
  {
    image.setTo(0, stuck == 1);
    image.setTo(65535, stuck == 2);
  };
  EXPECT_GT(largestError(flaw, false), 3.0) << "without the check the flaw does no harm, so this test tells nothing";
  EXPECT_LT(largestError(flaw, true), 0.3);
}

TEST(ExposureCheck, bladesHoldNoRegion)
{
  const Detector flaw = [](cv::Mat& image)
  {
    cv::Mat light;
    image.convertTo(light, CV_32F, 1.0, -kOffset);
    cv::Mat field(image.size(), CV_32FC1, cv::Scalar(0.003));
    field(cv::Rect(85, 68, 72, 64)) = 1.f;
    cv::GaussianBlur(field, field, {}, 1.2);
    light = light.mul(field) + kOffset;
    cv::Mat noise(image.size(), CV_32FC1);
    cv::randn(noise, 0.0, 4.0);
    light += noise;
    light.convertTo(image, CV_16U);
  };
  EXPECT_GT(largestError(flaw, false), 3.0) << "without the check the flaw does no harm, so this test tells nothing";
  EXPECT_LT(largestError(flaw, true), 0.3);
}

TEST(ExposureCheck, learnsOnlyWhatIsInsideTheField)
{
  cv::Mat image = exposeAt({ 0.0, 0.0 }, 1);
  ExposureCheck check(kCounts);
  EXPECT_EQ("", check.look(image, 1));
  EXPECT_EQ(kRegion, check.learn(image, kRegion));
  EXPECT_EQ(0.0, check.outside(kRegion));
  EXPECT_EQ(image.data, check.repaired(image).data) << "not copied where nothing is stuck";

  image.colRange(0, 100) = kOffset;
  EXPECT_EQ("", check.look(image, 2));
  const cv::Rect inside = check.learn(image, kRegion);
  EXPECT_GE(inside.x, 100);
  EXPECT_LE(inside.x, 110);
  EXPECT_EQ(kRegion.br(), inside.br());
  EXPECT_EQ(kRegion.y, inside.y);
  EXPECT_NEAR(0.35, check.outside(kRegion), 0.1);

  image.colRange(0, 150) = kOffset;
  EXPECT_EQ("", check.look(image, 3));
  try
  {
    check.learn(image, kRegion);
    ADD_FAILURE() << "learnt from a region behind a blade";
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string::npos, std::string(error.what()).find("100 x 90 at (70, 55)")) << error.what();
    EXPECT_NE(std::string::npos, std::string(error.what()).find("inside the field")) << error.what();
  }
}

TEST(ExposureCheck, tellsWhatShowsNothingNew)
{
  ExposureCheck check(kCounts);
  const auto expect_fault = [&check](const cv::Mat& image, std::int64_t stamp, const std::string& words)
  { EXPECT_NE(std::string::npos, check.look(image, stamp).find(words)) << check.look(image, stamp); };
  cv::Mat black(exposureSize(), CV_16UC1);
  cv::randn(black, kOffset, 5.0);
  expect_fault(black, 1, "shows nothing");
  const cv::Mat first = exposeAt({ 0.0, 0.0 }, 1), second = exposeAt({ 0.0, 0.0 }, 2);
  EXPECT_EQ("", check.look(first, 1500000000)) << "its own noise makes an exposure a new one";
  EXPECT_EQ("", check.look(second, 2000000000));
  expect_fault(second.clone(), 2500000000, "that of 2.000");
  expect_fault(first, 3000000000, "that of 1.500");
  check.reset();
  EXPECT_EQ("", check.look(first, 1));
}

TEST(ExposureCheck, tellsRowsOfTwoExposures)
{
  ExposureCheck check(kCounts);
  const cv::Mat before = exposeAt({ 0.0, 0.0 }, 1), now = exposeAt({ 5.0, 2.0 }, 2);
  EXPECT_EQ("", check.look(before, 1));
  EXPECT_EQ("", check.mixed(before, kRegion));
  cv::Mat woven = now.clone();
  for (int y = 1; y < now.rows; y += 2)
  {
    before.row(y).copyTo(woven.row(y));
  }
  EXPECT_EQ("", check.look(now, 2));
  EXPECT_EQ("", check.mixed(now, kRegion));
  EXPECT_NE(std::string::npos, check.mixed(woven, kRegion).find("every other row"));
}

TEST(ExposureCheck, learnsStuckPixelsLater)
{
  ExposureCheck check(kCounts);
  cv::Mat image = exposeAt({ 0.0, 0.0 }, 1);
  check.look(image, 1);
  check.learn(image, kRegion);
  EXPECT_FALSE(check.learnStuck(image));
  image = exposeAt({ 0.0, 0.0 }, 2);
  const cv::Mat right = image.clone();
  image.at<std::uint16_t>(80, 90) = 65535;
  EXPECT_TRUE(check.learnStuck(image));
  EXPECT_FALSE(check.learnStuck(image));
  EXPECT_NEAR(right.at<std::uint16_t>(80, 90), check.repaired(image).at<std::uint16_t>(80, 90), 2000);
}
}  // namespace
}  // namespace xray_tracking
