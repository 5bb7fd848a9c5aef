#include "xray_tracking_motion_estimation/pose_history.h"

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
RigidTransform shifted(double x)
{
  RigidTransform transform = RigidTransform::Identity();
  transform.translation().x() = x;
  return transform;
}

TEST(PoseHistory, FindsExactlyTheStamp)
{
  PoseHistory history(10);
  EXPECT_TRUE(history.empty());
  history.add({ 100, shifted(1.0), false });
  history.add({ 200, shifted(2.0), true });
  ASSERT_TRUE(history.at(100));
  EXPECT_EQ(history.at(100)->room_from_patient.translation().x(), 1.0);
  EXPECT_EQ(history.at(200)->room_from_patient.translation().x(), 2.0);
  EXPECT_FALSE(history.at(101));
}

TEST(PoseHistory, ForgetsTheOldest)
{
  PoseHistory history(3);
  for (int stamp = 0; stamp < 5; ++stamp)
  {
    history.add({ stamp, shifted(stamp), false });
  }
  EXPECT_FALSE(history.at(1));
  EXPECT_TRUE(history.at(2));
  EXPECT_TRUE(history.at(4));
  history.clear();
  EXPECT_FALSE(history.at(4));
}

TEST(PoseHistory, CorrectsWhatWasTrackedAloneOnce)
{
  PoseHistory history(3);
  history.add({ 1, shifted(1.0), true });
  history.add({ 2, shifted(2.0), false });
  for (int i = 0; i < 2; ++i)
  {
    history.correctTracked([](const RigidTransform& pose) { return shifted(pose.translation().x() + 0.5); });
    EXPECT_EQ(history.at(1)->room_from_patient.translation().x(), 1.0);
    EXPECT_EQ(history.at(2)->room_from_patient.translation().x(), 2.5);
  }
}

TEST(PoseHistory, ForgetsWhatWasTrackedAlone)
{
  PoseHistory history(3);
  history.add({ 1, shifted(1.0), true });
  history.add({ 2, shifted(2.0), false });
  history.add({ 3, shifted(3.0), true });
  history.forgetTracked();
  EXPECT_TRUE(history.at(1));
  EXPECT_FALSE(history.at(2));
  EXPECT_TRUE(history.at(3));
}
}  // namespace
}  // namespace xray_tracking
