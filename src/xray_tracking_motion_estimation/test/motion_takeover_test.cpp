// What is known of poses goes on in another monitor's place.

#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "monitor_test.h"

namespace xray_tracking
{
namespace
{
using TakenUpTest = MonitorTest;

TEST_F(TakenUpTest, MotionCountsFromTheSamePoseOnceARegistrationHasConfirmedIt)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  registered({ 1.0, 0.0, 0.0 }, { 0.3, 0.0, 0.0 });
  expose({ 2.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 2.3, 0.0, 0.0 }, 1e-3);
  die();
  EXPECT_FALSE(monitor->gate().open());

  // A registration that refuses confirms nothing, and the next two have to agree.
  expose({ 2.5, 0.0, 0.0 });
  const RefinementRequest asked = request();
  EXPECT_TRUE(asked.unverified);
  EXPECT_NEAR((asked.room_from_patient.translation() - initialPose().translation()).x(), 2.8, 1e-3);
  monitor->onReply(doubted(asked.id), now);
  expectNone(decision(), MotionState::NO_REFERENCE, "has died");
  for (int i = 0; i < 2; ++i)
  {
    EXPECT_FALSE(monitor->gate().verification().verified());
    expectPose(registered({ 3.0, 0.0, 0.0 }, { 0.3, 0.0, 0.0 }), PoseSource::REGISTERED, { 3.3, 0.0, 0.0 }, kExact);
  }
  EXPECT_TRUE(monitor->gate().verification().verified());
  expose({ 3.5, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 3.8, 0.0, 0.0 }, 1e-3);
}

/// Nobody asks a registration: what somebody said of the initial pose holds on, as the templates are those of then.
/// What the target did meanwhile nobody has seen.
TEST_F(TakenUpTest, TracksAloneGoOn)
{
  options.method = PoseMethod::TRACKING;
  options.refinement.mode = RefinementMode::NEVER;
  options.gate.verification.initial_pose_verified = true;
  start();
  expose({ 0.0, 0.0, 0.0 });
  expose({ 1.0, 0.0, 0.0 });
  while (monitor->takeDecision())
  {
  }
  die();
  monitor->tracks().heardFrom(stamp + kInterval, stamp + kInterval);
  for (int i = 0; i < options.gate.jump_exposures; ++i)
  {
    EXPECT_FALSE(monitor->gate().open());
    expose({ 1.5, 0.0, 0.0 });
    expectPose(decision(), PoseSource::TRACKED, { 1.5, 0.0, 0.0 }, 1e-3);
  }
  EXPECT_TRUE(monitor->gate().open()) << monitor->gate().text();
}

/// What the one before doubted is doubted still.
TEST_F(TakenUpTest, ADoubtGoesOnToo)
{
  options.method = PoseMethod::TRACKING;
  options.refinement.mode = RefinementMode::NEVER;
  options.gate.verification.initial_pose_verified = true;
  start();
  stamp += 100 * kInterval;
  monitor->tracks().heardFrom(stamp, stamp);  // templates that are older than what was heard of
  for (int i = 0; i < 3; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
  }
  while (monitor->takeDecision())
  {
  }
  EXPECT_FALSE(monitor->gate().verification().verified());
  EXPECT_NE(die().doubt, "");
  for (int i = 0; i < 40; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
  }
  EXPECT_FALSE(monitor->gate().open());
  EXPECT_NE(monitor->gate().text().find("before the first exposure"), std::string::npos) << monitor->gate().text();
}

/// Trackers that were killed as well, and have learnt elsewhere: no silent wrong reference.
TEST_F(TakenUpTest, TemplatesThatItDoesNotKnowHaveNoReference)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  die();
  trained.assign(2, { stamp + kInterval, Eigen::Vector3d(3.0, 0.0, 0.0) });
  expose({ 3.0, 0.0, 0.0 });
  monitor->onReply(believed(request().id, { 3.0, 0.0, 0.0 }), now);
  expectNone(decision(), MotionState::NO_REFERENCE, "trained on the exposure at");
  expectPose(registered({ 3.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 3.0, 0.0, 0.0 }, kExact);
}

TEST_F(TakenUpTest, AnotherRegionOfTheSameExposureIsAnotherTemplate)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  registered({ 0.0, 0.0, 0.0 });
  die();
  expose({ 0.0, 0.0, 0.0 },
         [](std::vector<std::optional<TrackedView>>& views) { views[0]->track.centre += Eigen::Vector2d(30.0, 0.0); });
  monitor->onReply(doubted(request().id), now);
  expectNone(decision(), MotionState::NO_REFERENCE, "detector_a");
}

/// Nobody learns anew, or follows, what was in front of a view when the node died.
TEST_F(TakenUpTest, WhatHidTheTargetIsKnownStill)
{
  const auto see = [this](double first_similarity)
  {
    expose({ 0.0, 0.0, 0.0 });
    RefinementReply reply = believed(request().id, { 0.0, 0.0, 0.0 });
    reply.view_similarities = { first_similarity, 0.9 };
    monitor->onReply(reply, now);
    return decision();
  };
  const auto tracked_alone = [this]
  {
    expose({ 0.0, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    return decision();
  };
  start();
  see(0.9);
  see(0.9);
  trained[0].first = stamp;
  see(0.14);
  die();
  EXPECT_TRUE(monitor->tracks().isHidden(0));
  see(0.14);
  see(0.14);
  EXPECT_TRUE(monitor->tracks().isHidden(0)) << "its usual similarity is known still";
  expectNone(tracked_alone(), MotionState::LOST, "hides the target from detector_a");
  see(0.9);
  see(0.9);
  EXPECT_FALSE(monitor->tracks().isHidden(0));
  expectNone(tracked_alone(), MotionState::LOST, "while something hid the target");
}

TEST_F(TakenUpTest, NothingIsKeptBeforeThereIsAPose)
{
  start();
  EXPECT_FALSE(monitor->memory());
  expose({ 0.0, 0.0, 0.0 }, loseAll);
  EXPECT_FALSE(monitor->memory());
}
}  // namespace
}  // namespace xray_tracking
