#include "xray_tracking_motion_estimation/motion_memory.h"

#include <limits>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

#include "scene.h"

namespace xray_tracking
{
namespace
{
Track someTrack()
{
  Track track;
  track.model = TrackModel::EUCLIDEAN;
  track.centre = { 100.5, 1.0 / 3.0 };
  track.displacement = { -0.1, 1e-17 };
  track.linear = Eigen::Rotation2Dd(0.1).toRotationMatrix();
  track.covariance = 1e-3 * Matrix6d::Identity();
  return track;
}

RunMemory someMemory()
{
  RunMemory memory;
  memory.detectors = cyberknife();
  memory.hold = "held by an \"operator\"";
  memory.operator_present = true;
  MotionMemory& motion = memory.motion.emplace();
  ViewReference reference;
  reference.template_stamp = 1700000000123456789;
  reference.region = { 3, 4, 50, 60 };
  reference.learnt_at = initialPose();
  reference.room_from_patient = moved(initialPose(), { M_PI, 0.1, -1e-9 });
  reference.anchor = someTrack();
  reference.anchor_stamp = 1700000000987654321;
  reference.registered = true;
  motion.references = { reference, std::nullopt };
  motion.sights = { { 0.1 + 0.2, true, 1700000000123456789, true, 1700000000023456789 }, {} };
  motion.reference = moved(initialPose(), { 1.0 / 7.0, 0.0, 0.0 });
  motion.reference_covariance = 0.01 * Matrix6d::Identity();
  motion.last_stamp = 1700000001123456789;
  motion.last_pose = moved(initialPose(), { 0.0, 1.0 / 9.0, 0.0 });
  motion.doubt = "a doubt";
  return memory;
}

/// Numbers come back to the last bit.
TEST(MotionMemory, ComesBackAsItWas)
{
  const RunMemory was = someMemory();
  const RunMemory is = runMemoryFrom(textOf(was));
  ASSERT_EQ(is.detectors.size(), 2u);
  EXPECT_EQ(is.detectors[1].source, was.detectors[1].source);
  EXPECT_EQ(is.detectors[1].x_direction, was.detectors[1].x_direction);
  EXPECT_EQ(is.hold, was.hold);
  EXPECT_TRUE(is.operator_present);
  ASSERT_TRUE(is.motion);
  ASSERT_EQ(is.motion->references.size(), 2u);
  EXPECT_FALSE(is.motion->references[1]);
  const ViewReference& reference = *is.motion->references[0];
  EXPECT_EQ(reference.template_stamp, 1700000000123456789);
  EXPECT_EQ(reference.region, cv::Rect(3, 4, 50, 60));
  EXPECT_EQ(reference.learnt_at.matrix(), initialPose().matrix());
  EXPECT_EQ(reference.room_from_patient.matrix(), was.motion->references[0]->room_from_patient.matrix());
  EXPECT_TRUE(reference.registered);
  EXPECT_EQ(reference.anchor_stamp, 1700000000987654321);
  ASSERT_TRUE(reference.anchor);
  EXPECT_EQ(reference.anchor->model, TrackModel::EUCLIDEAN);
  EXPECT_EQ(reference.anchor->warp(), someTrack().warp());
  EXPECT_EQ(reference.anchor->centre, someTrack().centre);
  EXPECT_EQ(reference.anchor->covariance, someTrack().covariance);
  ASSERT_EQ(is.motion->sights.size(), 2u);
  EXPECT_EQ(is.motion->sights[0].usual, 0.1 + 0.2);
  EXPECT_TRUE(is.motion->sights[0].hidden);
  EXPECT_EQ(is.motion->sights[0].template_stamp, 1700000000123456789);
  EXPECT_TRUE(is.motion->sights[0].template_hidden);
  EXPECT_EQ(is.motion->sights[0].stated, 1700000000023456789);
  EXPECT_FALSE(is.motion->sights[1].usual);
  EXPECT_FALSE(is.motion->sights[1].hidden);
  EXPECT_FALSE(is.motion->sights[1].template_stamp);
  EXPECT_FALSE(is.motion->sights[1].template_hidden);
  EXPECT_FALSE(is.motion->sights[1].stated);
  EXPECT_EQ(is.motion->reference.matrix(), was.motion->reference.matrix());
  EXPECT_EQ(is.motion->reference_covariance, was.motion->reference_covariance);
  EXPECT_EQ(is.motion->last_stamp, was.motion->last_stamp);
  EXPECT_EQ(is.motion->last_pose.matrix(), was.motion->last_pose.matrix());
  EXPECT_EQ(is.motion->doubt, "a doubt");
  EXPECT_EQ(difference(is.detectors, geometriesOf(was.detectors)), "");
  EXPECT_FALSE(runMemoryFrom(textOf(RunMemory())).motion);
}

TEST(MotionMemory, WhatIsNoneIsRefused)
{
  const auto refused = [](const RunMemory& memory)
  { EXPECT_THROW(runMemoryFrom(textOf(memory)), std::invalid_argument); };
  RunMemory memory = someMemory();
  memory.motion->last_pose.translation().x() = std::numeric_limits<double>::quiet_NaN();
  refused(memory);
  memory = someMemory();
  memory.motion->reference.linear() *= 1.01;
  refused(memory);
  memory = someMemory();
  memory.motion->reference_covariance(2, 2) = -1.0;
  refused(memory);
  memory = someMemory();
  memory.motion->references[0]->anchor->linear.col(0) *= -1.0;
  refused(memory);
  memory = someMemory();
  memory.motion->references.pop_back();
  refused(memory);
  memory = someMemory();
  memory.motion->sights.pop_back();
  refused(memory);
  memory = someMemory();
  memory.motion->sights[0].usual = 1.5;
  refused(memory);
  EXPECT_THROW(runMemoryFrom(""), std::invalid_argument);
  EXPECT_THROW(runMemoryFrom("[1, 2]"), std::invalid_argument);
  EXPECT_THROW(runMemoryFrom("{\"detectors\": 3}"), std::invalid_argument);
}

/// Whatever a text has become: it is read, or refused in words; nothing that is not finite comes out.
TEST(MotionMemory, AlteredTextsAreReadOrRefused)
{
  const std::string good = textOf(someMemory());
  std::mt19937 random(5);
  int refusals = 0;
  for (int i = 0; i < 10000; ++i)
  {
    std::string bad = good;
    for (unsigned changes = 1 + random() % 4; changes > 0; --changes)
    {
      const std::size_t at = random() % bad.size();
      switch (random() % 3)
      {
        case 0:
          bad[at] = static_cast<char>(random() % 256);
          break;
        case 1:
          bad.erase(at, 1 + random() % 40);
          break;
        default:
          bad.insert(at, good.substr(random() % good.size(), random() % 40));
      }
    }
    try
    {
      const RunMemory memory = runMemoryFrom(bad);
      if (memory.motion)
      {
        EXPECT_TRUE(isRigid(memory.motion->last_pose) && isRigid(memory.motion->reference));
        EXPECT_TRUE(memory.motion->reference_covariance.allFinite());
      }
    }
    catch (const std::invalid_argument& error)
    {
      EXPECT_STRNE(error.what(), "");
      ++refusals;
    }
  }
  EXPECT_GT(refusals, 1000);
}

TEST(MotionMemory, ADetectorThatStandsDifferentlyIsTold)
{
  const std::vector<DetectorDescription> then = cyberknife();
  std::vector<DetectorDescription> now = then;
  now[1].origin.x() += 0.001;
  EXPECT_NE(difference(then, geometriesOf(now)).find("detector_b"), std::string::npos);
  now = then;
  now[0].name = "detector_c";
  EXPECT_NE(difference(then, geometriesOf(now)), "");
  now = then;
  now.pop_back();
  EXPECT_NE(difference(then, geometriesOf(now)), "");
}
}  // namespace
}  // namespace xray_tracking
