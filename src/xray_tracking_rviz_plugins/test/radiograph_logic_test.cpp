// What is known of a detector, its exposures and its track.
#include <cmath>

#include <gtest/gtest.h>

#include <boost/make_shared.hpp>

#include "alignment.h"
#include "detector_view.h"
#include "radiograph_feed.h"
#include "room_watch.h"
#include "track_shape.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::TrackedRegion;

std::vector<ros::Time> times(const std::vector<double>& seconds)
{
  std::vector<ros::Time> result;
  for (const double s : seconds)
  {
    result.emplace_back(s);
  }
  return result;
}

TEST(Detectors, AreFoundByTheirImages)
{
  const std::vector<std::string> topics{ "/room1/left/image_raw",
                                         "/room1/left/camera_info",
                                         "/room2/a/image_raw",
                                         "/room1/b/image_raw",
                                         "/room1/b/image_raw",
                                         "/image_raw",
                                         "image_raw" };
  EXPECT_EQ(detectorsOf(topics, "/room1"), (std::vector<std::string>{ "/room2/a", "b", "left" }));
  EXPECT_EQ(detectorsOf({ "/a/image_raw" }, "/"), std::vector<std::string>{ "a" });
}

TEST(ExposureToShow, IsTheNewestThatIsComplete)
{
  const auto images = times({ 1.0, 1.1, 1.2, 1.3 });
  EXPECT_EQ(exposureToShow(images, {}, 0.02, 0.3), ros::Time(1.3));
  EXPECT_EQ(exposureToShow(images, { times({ 1.0, 1.1, 1.2 }), times({ 1.0, 1.1 }) }, 0.02, 0.3), ros::Time(1.1));
  // What the next one, of 1.1 s, has been without for 0.2 s and more.
  EXPECT_EQ(exposureToShow(images, { times({ 1.0 }) }, 0.02, 0.25), ros::Time(1.0));
  EXPECT_EQ(exposureToShow(images, { times({ 1.0 }) }, 0.06, 0.25), ros::Time(1.3));
}

TEST(ExposureToShow, StaysCompleteBetweenExposuresThatComeSlowly)
{
  for (const double interval : { 0.033, 0.5, 5.0 })
  {
    const auto images = times({ 10.0, 10.0 + interval });
    const std::vector<std::vector<ros::Time>> late{ times({ 10.0 }) };
    EXPECT_EQ(exposureToShow(images, late, 0.1, 0.3), images[0]) << interval;
    EXPECT_EQ(exposureToShow(images, late, 0.31, 0.3), images[1]) << interval;
    EXPECT_EQ(exposureToShow(images, { images }, 0.1, 0.3), images[1]) << interval;
  }
}

TEST(ReplacedFor, CountsFromWhenTheNextOneCame)
{
  const auto images = times({ 10.0, 10.2, 10.4 });
  EXPECT_EQ(replacedFor(images, ros::Time(10.4), 7.0), 0.0);
  EXPECT_NEAR(replacedFor(images, ros::Time(10.2), 7.0), 7.0, 1e-9);
  EXPECT_NEAR(replacedFor(images, ros::Time(10.0), 0.1), 0.3, 1e-9);
  EXPECT_NEAR(replacedFor(images, ros::Time(9.0), 0.1), 1.5, 1e-9);
  EXPECT_TRUE(std::isinf(replacedFor(images, ros::Time(11.0), 0.1)));  // time has gone back
  EXPECT_TRUE(std::isinf(replacedFor({}, ros::Time(11.0), 0.0)));
}

TEST(Recent, BeginsAnewWhenTimeGoesBack)
{
  Recent<TrackedRegion> recent(3);
  const auto add = [&](double seconds)
  {
    auto region = boost::make_shared<TrackedRegion>();
    region->header.stamp = ros::Time(seconds);
    recent.add(region);
  };
  for (const double seconds : { 1.0, 2.0, 3.0, 4.0 })
  {
    add(seconds);
  }
  EXPECT_EQ(recent.messages().size(), 3U);
  EXPECT_TRUE(recent.at(ros::Time(2.0)));
  EXPECT_FALSE(recent.at(ros::Time(1.0)));
  add(1.5);
  EXPECT_EQ(recent.messages().size(), 1U);
  EXPECT_EQ(recent.newest()->header.stamp, ros::Time(1.5));
}

TEST(TrackShape, IsWhereTheMessageSays)
{
  TrackedRegion region;
  region.state = TrackedRegion::TRACKING;
  region.region.x_offset = 100;
  region.region.y_offset = 50;
  region.region.width = 21;
  region.region.height = 11;
  region.displacement_x = 4.0;
  region.displacement_y = -2.0;
  region.linear = { 0.0, -1.0, 1.0, 0.0 };  // a quarter turn: x to y
  const Outline began = *outlineBegan(region), now = *outlineNow(region);
  EXPECT_TRUE(began[0].isApprox(Eigen::Vector2d(99.5, 49.5)));
  EXPECT_TRUE(began[2].isApprox(Eigen::Vector2d(120.5, 60.5)));
  // Centre (110, 55) + (4, -2); the corner at (-10.5, -5.5) of it turns to (5.5, -10.5).
  EXPECT_TRUE(now[0].isApprox(Eigen::Vector2d(119.5, 42.5)));
  EXPECT_TRUE(centreNow(region)->isApprox(Eigen::Vector2d(114.0, 53.0)));
  region.displacement_x = std::nan("");
  EXPECT_FALSE(outlineNow(region));
  region.displacement_x = 0.0;
  region.state = TrackedRegion::LOST;
  EXPECT_FALSE(outlineNow(region));
  EXPECT_TRUE(outlineBegan(region));
  EXPECT_EQ(moodOf(region), Mood::BAD);
  region.region.width = 0;
  EXPECT_FALSE(outlineBegan(region));
}

TEST(TrackShape, DotsAreThoseThatMeanSomething)
{
  xray_tracking_msgs::RegionResiduals residuals;
  residuals.u = { 1.0F, 2.0F, std::nanf(""), 4.0F };
  residuals.v = { 5.0F, 6.0F, 7.0F, 8.0F };
  residuals.residual = { -0.25F, 3.0F, 0.5F, std::nanf("") };
  const std::vector<ResidualDot> dots = dotsOf(residuals);
  ASSERT_EQ(dots.size(), 2U);
  EXPECT_EQ(dots[0].pixel, Eigen::Vector2d(1.0, 5.0));
  EXPECT_EQ(dots[0].share, 0.25);
  EXPECT_EQ(dots[1].share, 1.0);
  residuals.v.pop_back();
  EXPECT_TRUE(dotsOf(residuals).empty());
}

/// Source 1.5 m above the isocentre, looking down; panel of 400 x 300 pixels of 0.5 mm, 2 m from it.
ProjectionGeometry overheadDetector()
{
  DetectorDescription panel;
  panel.name = "overhead";
  panel.image_size = { 400, 300 };
  panel.pixel_pitch = { 0.5, 0.5 };
  panel.source = { 0.0, 0.0, 1500.0 };
  panel.x_direction = Eigen::Vector3d::UnitX();
  panel.y_direction = -Eigen::Vector3d::UnitY();
  panel.origin = Eigen::Vector3d(-99.75, 74.75, -500.0);
  return ProjectionGeometry::fromDescription(panel);
}

TEST(DetectorView, TellsMillimetresAtTheIsocentre)
{
  const ProjectionGeometry overhead = overheadDetector();
  // The isocentre is seen at the panel's middle, (199.5, 149.5); a pixel there is 0.375 mm.
  EXPECT_TRUE(atIsocentre(overhead, { 199.5 + 20.0, 149.5 - 8.0 }).isApprox(Eigen::Vector2d(7.5, -3.0)));
}

TEST(DetectorView, TellsAttenuation)
{
  IntensityModel intensity;
  intensity.offset = 100.0;
  EXPECT_NEAR(*attenuationOf(1100.0, intensity, 20100.0), std::log(20.0), 1e-12);
  intensity.air_counts = 10100.0;
  EXPECT_NEAR(*attenuationOf(1100.0, intensity, 20100.0), std::log(10.0), 1e-12);
  EXPECT_NEAR(*attenuationOf(0.0, intensity, 20100.0), std::log(10000.0), 1e-12);
  intensity.air_counts = 50.0;
  EXPECT_FALSE(attenuationOf(1100.0, intensity, 20100.0));
  intensity.kind = IntensityModel::Kind::ATTENUATION;
  EXPECT_EQ(*attenuationOf(3.5, intensity, 9.0), 3.5);
}

TEST(DetectorView, TakesThePanelsDistanceFromTheSetupThatFits)
{
  TreatmentSetup setup;
  setup.detectors.push_back(overheadDetector());
  sensor_msgs::CameraInfo info;
  info.K = { 4000.0, 0.0, 199.5, 0.0, 4000.0, 149.5, 0.0, 0.0, 1.0 };
  EXPECT_EQ(panelDistance(info, &setup, "overhead", 1234.0), 2000.0);
  EXPECT_EQ(panelDistance(info, &setup, "other", 1234.0), 1234.0);
  EXPECT_EQ(panelDistance(info, nullptr, "overhead", 1234.0), 1234.0);
  info.K[0] = 3000.0;
  EXPECT_EQ(panelDistance(info, &setup, "overhead", 1234.0), 1234.0);
  info.K[0] = std::nan("");
  EXPECT_EQ(panelDistance(info, &setup, "overhead", 1234.0), 1234.0);
}

TEST(ProjectedBox, HasTwelveEdgesWhereTheDetectorSeesThem)
{
  const ProjectionGeometry overhead = overheadDetector();
  const Eigen::AlignedBox3d box(Eigen::Vector3d(-10.0, -20.0, -30.0), Eigen::Vector3d(10.0, 20.0, 30.0));
  RigidTransform pose = RigidTransform::Identity();
  pose.translation() = Eigen::Vector3d(5.0, 0.0, 0.0);
  const std::vector<Segment> segments = projectedBox(overhead, pose, box);
  ASSERT_EQ(segments.size(), 12U);
  double right = 0.0, upper = 1e9;
  for (const Segment& segment : segments)
  {
    for (const Eigen::Vector2d& end : segment)
    {
      right = std::max(right, end.x());
      upper = std::min(upper, end.y());
    }
  }
  // Its upper face is 1470 mm from the source: a millimetre is 2000 / 1470 / 0.5 pixels.
  EXPECT_NEAR(right, 199.5 + 15.0 * 4000.0 / 1470.0, 1e-9);
  EXPECT_NEAR(upper, 149.5 - 20.0 * 4000.0 / 1470.0, 1e-9);
  pose.translation() = Eigen::Vector3d(0.0, 0.0, 5000.0);
  EXPECT_TRUE(projectedBox(overhead, pose, box).empty());
}

TEST(Alignment, ShiftsAndTurnsTheTargetAboutItsCentre)
{
  RigidTransform start = RigidTransform::Identity();
  start.linear() = Eigen::Quaterniond(0.5, 0.5, -0.5, 0.5).toRotationMatrix();
  start.translation() = Eigen::Vector3d(100.0, -200.0, 300.0);
  const Eigen::Vector3d centre(300.0, 250.0, -400.0);
  Alignment alignment(start, centre);
  EXPECT_TRUE(alignment.pose().isApprox(start, 1e-12));
  // A turn moves no target, however far the origin is from it.
  alignment.turnBy({ 0.0, 0.0, 0.1 });
  EXPECT_LT((alignment.pose() * centre - start * centre).norm(), 1e-9);
  const Eigen::Matrix3d about_z = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  EXPECT_TRUE(alignment.pose().linear().isApprox(about_z * start.linear(), 1e-12));
  // Along the room's axes, turned as it is.
  alignment.shiftBy({ 1.0, 2.0, -3.0 });
  EXPECT_LT((alignment.pose() * centre - start * centre - Eigen::Vector3d(1.0, 2.0, -3.0)).norm(), 1e-9);
  EXPECT_TRUE(alignment.turnVector().isApprox(Eigen::Vector3d(0.0, 0.0, 0.1), 1e-9));
  // Thousands of steps leave a rotation.
  for (int i = 0; i < 5000; ++i)
  {
    alignment.turnBy({ 0.01, -0.02, 0.03 });
  }
  EXPECT_TRUE(isRigid(alignment.pose()));
  EXPECT_LT((alignment.pose() * centre - start * centre - Eigen::Vector3d(1.0, 2.0, -3.0)).norm(), 1e-6);
}

TEST(Alignment, WhatIsNoPlaceChangesNothing)
{
  Alignment alignment(RigidTransform::Identity(), Eigen::Vector3d(1.0, 2.0, 3.0));
  const double nan = std::nan("");
  alignment.place({ nan, 0.0, 0.0 }, Eigen::Quaterniond::Identity());
  alignment.place({ 5.0, 0.0, 0.0 }, Eigen::Quaterniond(0.0, 0.0, 0.0, 0.0));
  alignment.place({ 5.0, 0.0, 0.0 }, Eigen::Quaterniond(nan, 0.0, 0.0, 0.0));
  alignment.shiftBy({ 0.0, std::numeric_limits<double>::infinity(), 0.0 });
  alignment.turnBy({ 0.0, nan, 0.0 });
  EXPECT_TRUE(alignment.pose().isApprox(RigidTransform::Identity(), 0.0));
  EXPECT_EQ(alignment.shift(), Eigen::Vector3d::Zero());
}
}  // namespace
}  // namespace xray_tracking
