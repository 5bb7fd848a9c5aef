#include "xray_tracking_hyperplane_tracker/region_overlay.h"

#include <gtest/gtest.h>

#include "synthetic_exposure.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kRegion(70, 55, 100, 90);
const cv::Scalar kGreen(80, 200, 80);

bool isColour(const cv::Mat& picture, const cv::Point& place, const cv::Scalar& colour)
{
  const cv::Vec3b pixel = picture.at<cv::Vec3b>(place);
  return pixel[0] == colour[0] && pixel[1] == colour[1] && pixel[2] == colour[2];
}

TEST(RegionOverlay, drawsReferenceAndTrackedRegion)
{
  RegionOverlay overlay;
  overlay.reference = kRegion;
  overlay.found.emplace();
  overlay.found->displacement = { 12.4, -7.6 };
  overlay.colour = kGreen;
  const cv::Mat picture = drawRegionOverlay(expose({}), overlay);
  ASSERT_EQ(picture.type(), CV_8UC3);
  ASSERT_EQ(picture.size(), exposureSize());
  EXPECT_TRUE(isColour(picture, { 70, 120 }, cv::Scalar(160, 160, 160)));
  EXPECT_TRUE(isColour(picture, { 70 + 12, 100 - 8 }, kGreen));
  EXPECT_FALSE(isColour(picture, { 120, 100 }, kGreen));
}

TEST(RegionOverlay, drawsTheLinearPartAndPoints)
{
  RegionOverlay overlay;
  overlay.reference = kRegion;
  overlay.colour = kGreen;
  overlay.found.emplace();
  overlay.found->linear << 0.5, 0.0, 0.0, 1.0;  // half as wide about its centre at 119.5
  overlay.points = { { { 110.0F, 90.0F }, 0.0F }, { { 130.0F, 90.0F }, -1.0F }, { { 120.0F, 110.0F }, 0.5F } };
  const cv::Mat picture = drawRegionOverlay(expose({}), overlay);
  EXPECT_TRUE(isColour(picture, { 95, 80 }, kGreen));
  EXPECT_TRUE(isColour(picture, { 144, 80 }, kGreen));
  EXPECT_TRUE(isColour(picture, { 110, 90 }, cv::Scalar(0, 255, 0)));
  EXPECT_TRUE(isColour(picture, { 130, 90 }, cv::Scalar(0, 0, 255)));
  EXPECT_TRUE(isColour(picture, { 120, 110 }, cv::Scalar(0, 255, 255)));
}

TEST(RegionOverlay, showsLostRegionsAndNoneInTheStatesColour)
{
  RegionOverlay overlay;
  overlay.colour = kGreen;
  const cv::Mat plain = drawRegionOverlay(expose({}, 120.0, CV_8UC1), overlay);
  overlay.reference = kRegion;
  const cv::Mat lost = drawRegionOverlay(expose({}, 120.0, CV_8UC1), overlay);
  EXPECT_FALSE(isColour(plain, { 70, 120 }, kGreen));
  EXPECT_TRUE(isColour(lost, { 70, 120 }, kGreen));
  // Grey values spread over the window, not all at one end.
  cv::Scalar mean, deviation;
  cv::meanStdDev(plain, mean, deviation);
  EXPECT_GT(deviation[0], 20.0);
}
}  // namespace
}  // namespace xray_tracking
