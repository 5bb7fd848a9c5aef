#include "grey_scale.h"

#include <random>

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>

namespace xray_tracking
{
namespace
{
sensor_msgs::ImagePtr imageOf(const std::string& encoding, std::uint32_t width, std::uint32_t height,
                              std::uint32_t step)
{
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->encoding = encoding;
  image->width = width;
  image->height = height;
  image->step = step;
  image->data.resize(std::size_t{ step } * height);
  return image;
}

TEST(PixelsOf, ReadsRowsWithPaddingAndEitherByteOrder)
{
  const sensor_msgs::ImagePtr image = imageOf("mono16", 3, 2, 8);
  image->data[8 + 4] = 0x34;  // row 1, column 2
  image->data[8 + 5] = 0x12;
  EXPECT_EQ(pixelsOf(image).at<std::uint16_t>(1, 2), 0x1234);
  image->is_bigendian = true;
  EXPECT_EQ(pixelsOf(image).at<std::uint16_t>(1, 2), 0x3412);
}

TEST(PixelsOf, RefusesWhatIsNoRadiograph)
{
  EXPECT_THROW(pixelsOf(imageOf("rgb8", 4, 4, 12)), std::invalid_argument);
  EXPECT_THROW(pixelsOf(imageOf("mono16", 0, 4, 0)), std::invalid_argument);
  EXPECT_THROW(pixelsOf(imageOf("mono16", 4, 4, 7)), std::invalid_argument);
  const sensor_msgs::ImagePtr lacking = imageOf("mono8", 4, 4, 4);
  lacking->data.resize(15);
  EXPECT_THROW(pixelsOf(lacking), std::invalid_argument);
  const sensor_msgs::ImagePtr huge = imageOf("mono8", 4, 4, 4);
  huge->height = 0x40000001;  // times its step is 4 in 32 bits
  EXPECT_THROW(pixelsOf(huge), std::invalid_argument);
}

/// Saturated air and a blocked field, a third of the image each, do not count.
TEST(AutomaticWindow, SpansWhatIsBetweenTheEnds)
{
  std::mt19937 random(3);
  std::uniform_int_distribution<int> between(20000, 30000);
  cv::Mat pixels(300, 300, CV_16UC1, cv::Scalar(0));
  pixels.rowRange(200, 300).setTo(65535);
  for (int row = 100; row < 200; ++row)
  {
    for (int column = 0; column < pixels.cols; ++column)
    {
      pixels.at<std::uint16_t>(row, column) = static_cast<std::uint16_t>(between(random));
    }
  }
  const GreyWindow window = automaticWindow(pixels, false);
  // The percentiles are 1 % inside, the margin is 5 % outside.
  EXPECT_NEAR(window.low, 19600.0, 150.0);
  EXPECT_NEAR(window.high, 30400.0, 150.0);
  // Two values are a picture, too.
  cv::Mat two(100, 100, CV_8UC1, cv::Scalar(20));
  two(cv::Rect(10, 10, 15, 15)).setTo(200);
  EXPECT_LT(automaticWindow(two, false).low, 20.0);
  EXPECT_GT(automaticWindow(two, false).high, 200.0);
  const GreyWindow flat = automaticWindow(cv::Mat(64, 64, CV_8UC1, cv::Scalar(7)), true);
  EXPECT_LT(flat.low, flat.high);
}

TEST(GreyScale, IsProportionalToTheValueOrToItsLogarithm)
{
  cv::Mat pixels(1, 4, CV_16UC1);
  pixels.at<std::uint16_t>(0) = 50;
  pixels.at<std::uint16_t>(1) = 100;
  pixels.at<std::uint16_t>(2) = 1000;
  pixels.at<std::uint16_t>(3) = 20000;
  GreyScale scale;
  cv::Mat grey;
  scale.convert(pixels, { 100.0, 10000.0, true }, false, grey);
  EXPECT_EQ(grey.at<std::uint8_t>(0), 0);
  EXPECT_EQ(grey.at<std::uint8_t>(1), 0);
  EXPECT_NEAR(grey.at<std::uint8_t>(2), 127.5, 0.6);  // half of two decades
  EXPECT_EQ(grey.at<std::uint8_t>(3), 255);
  scale.convert(pixels, { 0.0, 2000.0, false }, true, grey);
  EXPECT_NEAR(grey.at<std::uint8_t>(2), 127.5, 0.6);
  EXPECT_EQ(grey.at<std::uint8_t>(3), 0);
}

TEST(GreyWindow, IsWidenedAroundItsLevel)
{
  const GreyWindow wider = GreyWindow{ 1000.0, 3000.0, false }.adjusted(0.0, 1.0);
  EXPECT_DOUBLE_EQ(wider.low, 0.0);
  EXPECT_DOUBLE_EQ(wider.high, 4000.0);
  const GreyWindow brighter = GreyWindow{ 1000.0, 3000.0, false }.adjusted(0.25, 0.0);
  EXPECT_DOUBLE_EQ(brighter.low, 500.0);
  const GreyWindow far = GreyWindow{ 1000.0, 3000.0, true }.adjusted(1e9, -1e9);
  EXPECT_LT(far.low, far.high);
  EXPECT_TRUE(std::isfinite(far.low) && std::isfinite(far.high));
}

TEST(WindowFollower, FollowsNoiseSlowlyAndAnotherImageAtOnce)
{
  WindowFollower follower;
  EXPECT_DOUBLE_EQ(follower.follow({ 100.0, 200.0, false }).low, 100.0);
  EXPECT_NEAR(follower.follow({ 110.0, 210.0, false }).low, 101.5, 1e-9);
  EXPECT_DOUBLE_EQ(follower.follow({ 5000.0, 9000.0, false }).low, 5000.0);
}
}  // namespace
}  // namespace xray_tracking
