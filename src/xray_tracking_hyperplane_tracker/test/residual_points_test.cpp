#include "xray_tracking_hyperplane_tracker/residual_points.h"

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "synthetic_exposure.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kRegion(70, 55, 100, 90);

double rootMeanSquare(const std::vector<ResidualPoint>& points)
{
  double sum = 0.0;
  for (const ResidualPoint& point : points)
  {
    sum += point.residual * point.residual;
  }
  return std::sqrt(sum / static_cast<double>(points.size()));
}

Exposure moved()
{
  Exposure exposure;
  exposure.displacement = { 3.4, -5.2 };
  exposure.linear = Eigen::Rotation2Dd(0.05).toRotationMatrix();
  exposure.shading = 0.2;
  exposure.gain = 0.8;
  return exposure;
}

TrackResult trackOf(const Exposure& exposure)
{
  TrackResult track;
  track.linear = exposure.linear;
  // The exposure turns about kCentre, a track about the region's centre.
  const Eigen::Vector2d arm =
      Eigen::Vector2d(kRegion.x + 0.5 * (kRegion.width - 1), kRegion.y + 0.5 * (kRegion.height - 1)) - kCentre;
  track.displacement = exposure.displacement + exposure.linear * arm - arm;
  return track;
}

TEST(ResidualPoints, areSmallWhereTheTrackIsRight)
{
  const cv::Mat reference = expose({});
  const cv::Mat image = expose(moved());
  const std::vector<ResidualPoint> right = residualPoints(reference, kRegion, image, trackOf(moved()), {});
  EXPECT_GT(right.size(), 300u);
  EXPECT_LT(right.size(), 500u);
  const std::vector<ResidualPoint> wrong = residualPoints(reference, kRegion, image, {}, {});
  // Bilinear sampling and noise; a wrong place leaves nearly everything.
  EXPECT_LT(rootMeanSquare(right), 0.15);
  EXPECT_GT(rootMeanSquare(wrong), 0.7);
}

TEST(ResidualPoints, areLargeWhereSomethingLiesOver)
{
  Exposure exposure = moved();
  exposure.cover = cv::Rect(80, 60, 30, 30);
  exposure.covering = 1.0;
  const TrackResult track = trackOf(exposure);
  double over = 0.0, beside = 0.0;
  int count_over = 0, count_beside = 0;
  for (const ResidualPoint& point : residualPoints(expose({}), kRegion, expose(exposure), track, {}))
  {
    const bool covered = exposure.cover.contains(cv::Point(cvRound(point.place.x), cvRound(point.place.y)));
    (covered ? over : beside) += std::abs(point.residual);
    ++(covered ? count_over : count_beside);
  }
  ASSERT_GT(count_over, 20);
  EXPECT_GT(over / count_over, 2.0 * beside / count_beside);
}

TEST(ResidualPoints, leaveOutWhatIsNotInTheImage)
{
  TrackResult track;
  track.displacement.x() = -120.0;  // half of the region is outside
  const std::vector<ResidualPoint> points = residualPoints(expose({}), kRegion, expose({}), track, {});
  EXPECT_GT(points.size(), 100u);
  EXPECT_LT(points.size(), 300u);
  for (const ResidualPoint& point : points)
  {
    EXPECT_GE(point.place.x, 0.0F);
    EXPECT_TRUE(std::isfinite(point.residual));
  }
  track.displacement.x() = -1e6;
  EXPECT_TRUE(residualPoints(expose({}), kRegion, expose({}), track, {}).empty());
}

TEST(ResidualPoints, areFiniteInFlatImages)
{
  const cv::Mat flat(exposureSize(), CV_16UC1, cv::Scalar(5000));
  for (const ResidualPoint& point : residualPoints(expose({}), kRegion, flat, {}, {}))
  {
    EXPECT_TRUE(std::isfinite(point.residual));
  }
}
}  // namespace
}  // namespace xray_tracking
