#include "monitor_test.h"

namespace xray_tracking
{
namespace
{
TEST_F(MonitorTest, PublishesTheRegisteredPoseOnceItIsThere)
{
  start();
  for (int i = 0; i < 5; ++i)
  {
    const Eigen::Vector3d motion(0.4 * i, -0.2 * i, 0.1 * i);
    const Eigen::Vector3d off(0.1, 0.2, -0.1);
    expose(motion);
    EXPECT_FALSE(monitor->takeDecision());
    EXPECT_EQ(monitor->wakeAt(), now + 100 * kMillisecond);
    const RefinementRequest asked = request();
    EXPECT_EQ(asked.stamp, stamp);
    // From where the tracks, counted from the last registered pose, put it.
    const Eigen::Vector3d seed = i == 0 ? motion : Eigen::Vector3d(motion + off);
    EXPECT_LT((asked.room_from_patient * scene.targetCentre() - scene.target - seed).norm(), 1e-3);
    EXPECT_EQ(asked.unverified, i == 0);
    monitor->onReply(believed(asked.id, motion + off), now + 20 * kMillisecond);
    const MotionDecision decision = this->decision();
    expectPose(decision, PoseSource::REGISTERED, motion + off, kExact);
    EXPECT_NEAR(decision.wall_seconds, 0.02, 1e-9);
    EXPECT_FALSE(monitor->wakeAt());
    EXPECT_TRUE(monitor->gate().verification().verified());
  }
  EXPECT_TRUE(monitor->gate().open()) << monitor->gate().text();
}

TEST_F(MonitorTest, TheTrackedPoseComesAtTheDeadlineAndALateAnswerMovesWhatFollows)
{
  start();
  registered({ 0.0, 0.0, 0.0 }, { 0.1, 0.0, 0.0 });
  expose({ 1.0, 0.0, 0.0 });
  const RefinementRequest late = request();
  monitor->onTime(now + 99 * kMillisecond);
  EXPECT_FALSE(monitor->takeDecision());
  monitor->onTime(*monitor->wakeAt());
  MotionDecision decision = this->decision();
  expectPose(decision, PoseSource::TRACKED, { 1.1, 0.0, 0.0 }, 1e-3);
  EXPECT_NE(decision.not_registered.find("no answer within 0.1 s"), std::string::npos) << decision.not_registered;
  // The next one waits for the registration, which is still at that one.
  expose({ 2.0, 0.0, 0.0 });
  EXPECT_FALSE(monitor->takeRequest());
  EXPECT_FALSE(monitor->takeDecision());
  monitor->onReply(believed(late.id, { 1.0, 0.3, 0.0 }), now + 10 * kMillisecond);
  const RefinementRequest asked = request();
  EXPECT_EQ(asked.stamp, stamp);
  EXPECT_LT((asked.room_from_patient * scene.targetCentre() - scene.target - Eigen::Vector3d(2.0, 0.3, 0.0)).norm(),
            1e-3);
  monitor->onReply(doubted(asked.id), now + 20 * kMillisecond);
  decision = this->decision();
  expectPose(decision, PoseSource::TRACKED, { 2.0, 0.3, 0.0 }, 1e-3);
  EXPECT_EQ(decision.not_registered, "the probability is 0.4");
}

TEST_F(MonitorTest, ExposuresWaitBehindEachOtherAndComeInOrder)
{
  start();
  std::vector<std::int64_t> stamps;
  for (int i = 0; i < 3; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
    now -= kInterval;  // all at once
    stamps.push_back(stamp);
  }
  for (int i = 0; i < 3; ++i)
  {
    const RefinementRequest asked = request();
    EXPECT_EQ(asked.stamp, stamps[static_cast<std::size_t>(i)]);
    EXPECT_FALSE(monitor->takeRequest());
    monitor->onReply(believed(asked.id, Eigen::Vector3d::Zero()), now + (i + 1) * 20 * kMillisecond);
    EXPECT_EQ(decision().stamp, stamps[static_cast<std::size_t>(i)]);
  }
}

// The first answer of a run takes longer than those that follow: what waits behind it is asked about all the same.
TEST_F(MonitorTest, OneSlowAnswerIsNoSlowRegistration)
{
  start();
  for (int i = 0; i < 3; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
    now -= kInterval;  // all at once, as trackers have learnt
  }
  now += kInterval;
  const RefinementRequest first = request();
  monitor->onReply(believed(first.id, Eigen::Vector3d::Zero()), now + 90 * kMillisecond);
  expectPose(decision(), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 }, kExact);
  EXPECT_EQ(request().stamp, stamp - kInterval);
}

TEST_F(MonitorTest, WhatAnswersTookIsForgottenAtARestart)
{
  start();
  for (const bool slow : { true, false })
  {
    for (int i = 0; slow && i < 2; ++i)
    {
      expose({ 0.0, 0.0, 0.0 });
      monitor->onReply(believed(request().id, Eigen::Vector3d::Zero()), now + 90 * kMillisecond);
      decision();
    }
    for (int i = 0; i < 3; ++i)
    {
      expose({ 0.0, 0.0, 0.0 });
      now -= kInterval;  // all at once
    }
    now += kInterval;
    monitor->onReply(believed(request().id, Eigen::Vector3d::Zero()), now + 90 * kMillisecond);
    // The one behind it could not be answered in time, if what came before says so.
    EXPECT_EQ(request().stamp, slow ? stamp : stamp - kInterval);
    monitor->restart("");
    while (monitor->takeDecision())
    {
    }
  }
}

// While trackers have yet to learn, the patient is taken to be at the initial pose: that time is no leave to go
// farther.
TEST_F(MonitorTest, WaitingForTheFirstTemplatesGivesNoLeaveToGoFar)
{
  start();
  const auto untrained = [](const std::string& fault)
  {
    return [fault](std::vector<std::optional<TrackedView>>& views)
    {
      for (std::optional<TrackedView>& view : views)
      {
        view->state = RegionState::UNTRAINED;
        view->fault = fault;
      }
    };
  };
  for (int i = 0; i < 15; ++i)
  {
    expose({ 0.0, 0.0, 0.0 }, untrained(""));
    expectNone(decision(), MotionState::WAITING, "untrained");
  }
  // 5 mm, and 15 mm/s for the 0.2 s since.
  expectNone(registered({ 0.0, 0.0, 0.0 }, { 9.5, 0.0, 0.0 }, untrained("no contrast")), MotionState::WAITING,
             "the correction is 9.5 mm and 0 rad, expected at most 8 mm");
}

TEST_F(MonitorTest, ARegistrationThatHangsHoldsUpNothing)
{
  options.refinement.timeout = 1.0;
  start();
  for (int i = 0; i < 20; ++i)
  {
    expose({ 0.1 * i, 0.0, 0.0 });
    monitor->takeRequest();
    monitor->onTime(now + 100 * kMillisecond);
    expectPose(decision(), PoseSource::TRACKED, { 0.1 * i, 0.0, 0.0 }, 1e-3);
  }
  EXPECT_GE(monitor->refinement().timeouts(), 2u);
  EXPECT_EQ(monitor->gate().reason(), GateReason::UNVERIFIED);
}

TEST_F(MonitorTest, OnlyRegisteredPosesWithTheMethodRegistration)
{
  options.method = PoseMethod::REGISTRATION;
  start();
  expectPose(registered({ 0.0, 0.0, 0.0 }, { 0.2, 0.0, 0.0 }), PoseSource::REGISTERED, { 0.2, 0.0, 0.0 }, kExact);
  expose({ 1.0, 0.0, 0.0 });
  const RefinementRequest asked = request();
  EXPECT_LT((asked.room_from_patient * scene.targetCentre() - scene.target - Eigen::Vector3d(0.2, 0.0, 0.0)).norm(),
            kExact)
      << "from the last one's pose";
  monitor->onReply(doubted(asked.id), now);
  expectNone(decision(), MotionState::UNREGISTERED, "the probability is 0.4");
  EXPECT_EQ(monitor->gate().reason(), GateReason::NOT_MEASURED);
}

TEST_F(MonitorTest, TrackingAloneWaitsForNothing)
{
  options.method = PoseMethod::TRACKING;
  start();
  expose({ 0.0, 0.0, 0.0 });
  expectPose(decision(), PoseSource::TRACKED, { 0.0, 0.0, 0.0 }, kExact);
  const RefinementRequest asked = request();
  expose({ 1.0, 0.0, 0.0 });
  expectPose(decision(), PoseSource::TRACKED, { 1.0, 0.0, 0.0 }, 1e-3);
  EXPECT_FALSE(monitor->takeRequest());
  monitor->onReply(believed(asked.id, { 0.3, 0.0, 0.0 }), now);
  expose({ 2.0, 0.0, 0.0 });
  expectPose(decision(), PoseSource::TRACKED, { 2.3, 0.0, 0.0 }, 1e-3);
}

TEST_F(MonitorTest, AContradictionEndsPosesUntilThreeRegistrationsAgree)
{
  start();
  for (int i = 0; i < 6; ++i)
  {
    registered({ 0.0, 0.0, 0.0 });
  }
  ASSERT_TRUE(monitor->gate().open());
  for (int i = 0; i < 2; ++i)
  {
    expectNone(registered({ 0.0, 0.0, 0.0 }, { 7.0, 0.0, 0.0 }), MotionState::INCONSISTENT, "contradict each other");
    EXPECT_FALSE(monitor->gate().open());
    EXPECT_FALSE(monitor->gate().verification().verified());
    EXPECT_FALSE(monitor->takeProposal()) << "who is right is not known";
  }
  expectPose(registered({ 0.0, 0.0, 0.0 }, { 7.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 7.0, 0.0, 0.0 }, kExact);
  // The views agree with each other on what is not the target: both learn it anew.
  for (std::size_t view = 0; view < 2; ++view)
  {
    const std::optional<RegionProposal> proposal = monitor->takeProposal();
    ASSERT_TRUE(proposal) << view;
    EXPECT_EQ(proposal->view, view);
    const TrackedView there = tracked(view, { 7.0, 0.0, 0.0 });
    const Eigen::Vector2d expected = Eigen::Vector2d(there.region.x, there.region.y) + there.track.displacement;
    EXPECT_LT((Eigen::Vector2d(proposal->region.x, proposal->region.y) - expected).norm(), 1.0);
  }
  // Until they have, their tracks count from there.
  expectPose(registered({ 0.5, 0.0, 0.0 }, { 7.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 7.5, 0.0, 0.0 }, kExact);
}

/// As where one view is of an earlier moment than the other: a registration may be believed all the same.
TEST_F(MonitorTest, TracksThatContradictEachOtherCloseTheGateOnARegisteredPose)
{
  start();
  for (int i = 0; i < 6; ++i)
  {
    registered({ 0.0, 0.0, 0.0 });
  }
  ASSERT_TRUE(monitor->gate().open());
  const auto late = [](std::vector<std::optional<TrackedView>>& views)
  { views[1]->track.displacement += Eigen::Vector2d(10.0, 10.0); };
  expectPose(registered({ 0.5, 0.0, 0.0 }, Eigen::Vector3d::Zero(), late), PoseSource::REGISTERED, { 0.5, 0.0, 0.0 },
             kExact);
  EXPECT_EQ(monitor->gate().reason(), GateReason::UNCERTAIN);
  EXPECT_NE(monitor->gate().text().find("tracks contradict each other"), std::string::npos) << monitor->gate().text();
  // From there on tracks are counted anew.
  for (int i = 0; i < 5; ++i)
  {
    EXPECT_FALSE(monitor->gate().open()) << i;
    registered({ 0.5, 0.0, 0.0 }, Eigen::Vector3d::Zero(), late);
  }
  EXPECT_TRUE(monitor->gate().open()) << monitor->gate().text();
}

TEST_F(MonitorTest, AContradictionStaysOneWhileNothingResolvesIt)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  registered({ 0.0, 0.0, 0.0 }, { 17.0, 0.0, 0.0 });
  for (int i = 0; i < 5; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    expectNone(decision(), MotionState::INCONSISTENT, "registration and tracks contradict each other");
  }
  for (int i = 0; i < 20; ++i)
  {
    expectNone(registered({ 0.0, 0.0, 0.0 }, { 17.0, 0.0, 0.0 }), MotionState::INCONSISTENT, "correction is 17");
  }
  expectPose(registered({ 0.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 }, kExact);
}

TEST_F(MonitorTest, WithoutTracksTheSecondRegistrationConfirmsTheFirst)
{
  start();
  expose({ 0.0, 0.0, 0.0 }, loseAll);
  monitor->onReply(believed(request().id, { 0.5, 0.0, 0.0 }), now);
  expectNone(decision(), MotionState::LOST, "which the next exposure has to confirm");
  expectPose(registered({ 0.5, 0.0, 0.0 }, { 0.0, 0.0, 0.0 }, loseAll), PoseSource::REGISTERED, { 0.5, 0.0, 0.0 },
             kExact);
  expectPose(registered({ 1.5, 0.0, 0.0 }, { 0.0, 0.0, 0.0 }, loseAll), PoseSource::REGISTERED, { 1.5, 0.0, 0.0 },
             kExact);
  // The next vertebra, 17 mm away, is farther than the target can have gone.
  expectNone(registered({ 1.5, 0.0, 0.0 }, { 17.0, 0.0, 0.0 }, loseAll), MotionState::LOST, "correction is 17");
}

TEST_F(MonitorTest, AViewThatHasLostItsRegionLearnsItWhereTheRegistrationSeesTheTarget)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  registered({ 2.0, 1.0, -1.0 });
  const Eigen::Vector3d there(4.0, 2.0, -2.0);
  registered({ 3.0, 1.5, -1.5 }, Eigen::Vector3d::Zero(), loseFirst);
  EXPECT_FALSE(monitor->takeProposal()) << "it may be back in the next one";
  expectPose(registered(there, Eigen::Vector3d::Zero(), loseFirst), PoseSource::REGISTERED, there, kExact);
  const std::optional<RegionProposal> proposal = monitor->takeProposal();
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->view, 0u);
  const TrackedView view = tracked(0, there);
  const Eigen::Vector2d expected = Eigen::Vector2d(view.region.x, view.region.y) + view.track.displacement;
  EXPECT_LT((Eigen::Vector2d(proposal->region.x, proposal->region.y) - expected).norm(), 1.0);
  EXPECT_EQ(proposal->region.size(), view.region.size());
  // The new template, of this exposure, is of use in the next one, without a registration too.
  trained[0] = { stamp, there };
  expose(there + Eigen::Vector3d(0.5, 0.0, 0.0));
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, there + Eigen::Vector3d(0.5, 0.0, 0.0), 2e-3);
}

TEST_F(MonitorTest, AViewThatFollowsSomethingElseIsFound)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  const auto stray = [](std::vector<std::optional<TrackedView>>& views) { views[1]->track.displacement.x() += 20.0; };
  expectPose(registered({ 0.0, 0.0, 0.0 }, Eigen::Vector3d::Zero(), stray), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 },
             kExact);
  EXPECT_FALSE(monitor->takeProposal()) << "tissue may have come between";
  const auto farther = [](std::vector<std::optional<TrackedView>>& views) { views[1]->track.displacement.x() += 40.0; };
  expectPose(registered({ 0.0, 0.0, 0.0 }, Eigen::Vector3d::Zero(), farther), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 },
             kExact);
  const std::optional<RegionProposal> proposal = monitor->takeProposal();
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->view, 1u);
  EXPECT_FALSE(monitor->takeProposal());
}

TEST_F(MonitorTest, NoPoseAfterARestartUntilOneIsConfirmed)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  stamp -= 1000 * kInterval;
  monitor->restart("time went back");
  trained.assign(2, { stamp + kInterval, Eigen::Vector3d::Zero() });
  for (int i = 0; i < 3; ++i)
  {
    expose({ 0.0, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    expectNone(decision(), MotionState::NO_REFERENCE, "time went back");
    EXPECT_FALSE(monitor->gate().open());
  }
  expectPose(registered({ 0.0, 0.0, 0.0 }, { 1.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 1.0, 0.0, 0.0 }, kExact);
  expose({ 0.5, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 1.5, 0.0, 0.0 }, 1e-3);
}

TEST_F(MonitorTest, WhatWaitedBeforeARestartIsForgotten)
{
  start();
  expose({ 0.0, 0.0, 0.0 });
  const RefinementRequest asked = request();
  monitor->restart("");
  monitor->onReply(believed(asked.id, { 3.0, 0.0, 0.0 }), now);
  EXPECT_FALSE(monitor->takeDecision());
  EXPECT_EQ(monitor->refinement().accepted(), 0u);
}

TEST_F(MonitorTest, ExposuresThatAreOfNoUseAreAnsweredAtOnce)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  TrackedExposure exposure;
  exposure.stamp = stamp + 1000000 * kInterval;
  exposure.arrival = now;
  exposure.fault = MotionState::BAD_STAMP;
  exposure.text = "of the future";
  monitor->onExposure(exposure, now);
  expectNone(decision(), MotionState::BAD_STAMP, "of the future");
  EXPECT_FALSE(monitor->takeRequest());
  expose({ 0.0, 0.0, 0.0 }, [](auto& views) { views[1]->state = RegionState::BLIND; });
  EXPECT_FALSE(monitor->takeRequest()) << "what shows nothing is no evidence";
  expectNone(decision(), MotionState::LOST, "detector_b is blind");
  expose({ 0.0, 0.0, 0.0 }, [](auto& views) { views[1].reset(); });
  monitor->onReply(doubted(request().id), now);
  expectNone(decision(), MotionState::LOST, "detector_b is silent");
}

// Two views of three are enough for tracks and for the registration.
TEST_F(MonitorTest, AViewOfThreeThatShowsNothingIsLeftOut)
{
  scene.views = viewsAround(3);
  options.tracks.views = { "a", "b", "c" };
  start();
  trained.push_back(trained.front());
  const auto seen = [this](std::optional<RegionState> second, RegionState third)
  {
    expose({ 0.0, 0.0, 0.0 },
           [&](std::vector<std::optional<TrackedView>>& views)
           {
             views.push_back(tracked(2, { 0.0, 0.0, 0.0 }));
             views[2]->state = third;
             if (second)
             {
               views[1]->state = *second;
             }
             else
             {
               views[1].reset();
             }
           });
  };
  const auto without = [this]
  {
    const RefinementRequest asked = request();
    monitor->onReply(believed(asked.id, { 0.0, 0.0, 0.0 }), now);
    expectPose(decision(), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 }, kExact);
    return asked.without;
  };
  seen(RegionState::TRACKING, RegionState::TRACKING);
  EXPECT_EQ(without(), (std::vector<bool>{ false, false, false }));
  seen(RegionState::BLIND, RegionState::TRACKING);
  EXPECT_EQ(without(), (std::vector<bool>{ false, true, false }));
  seen(std::nullopt, RegionState::TRACKING);
  EXPECT_EQ(without(), (std::vector<bool>{ false, true, false }));
  // One is no evidence.
  seen(RegionState::BLIND, RegionState::BLIND);
  EXPECT_FALSE(monitor->takeRequest());
  EXPECT_EQ(decision().not_registered, "b is blind");
}

/// With the method registration, where the tracked pose is not published.
TEST_F(MonitorTest, ALateAnswerIsThePoseThatTheNextOneIsFoundFrom)
{
  options.method = PoseMethod::REGISTRATION;
  start();
  const auto late = [this](const Eigen::Vector3d& motion, const Eigen::Vector3d& found) -> Eigen::Vector3d
  {
    expose(motion);
    const RefinementRequest asked = request();
    monitor->onTime(*monitor->wakeAt());
    expectNone(decision(), MotionState::UNREGISTERED, "no answer");
    monitor->onReply(believed(asked.id, found), now + 150 * kMillisecond);
    EXPECT_LT(monitor->gate().rotation(), 1e-6);
    return asked.room_from_patient * scene.targetCentre() - scene.target;
  };
  late({ 0.0, 0.0, 0.0 }, { 0.2, 0.0, 0.0 });
  EXPECT_LT((late({ 4.0, 0.0, 0.0 }, { 4.3, 0.0, 0.0 }) - Eigen::Vector3d(0.2, 0.0, 0.0)).norm(), kExact);
  EXPECT_LT((late({ 4.0, 0.0, 0.0 }, { 4.3, 0.0, 0.0 }) - Eigen::Vector3d(4.3, 0.0, 0.0)).norm(), kExact);
}

/// It takes longer than an exposure, but less than the deadline.
TEST_F(MonitorTest, ASlowRegistrationDoesNotFallBehindForGood)
{
  start();
  const std::int64_t interval = 33 * kMillisecond;
  std::optional<std::pair<std::int64_t, std::uint64_t>> under_way;  // when it answers, the request
  int exposures = 0, in_time = 0;
  for (const std::int64_t begin = now; exposures < 300; now += kMillisecond)
  {
    monitor->onTime(now);
    if (under_way && now >= under_way->first)
    {
      monitor->onReply(believed(std::exchange(under_way, std::nullopt)->second, Eigen::Vector3d::Zero()), now);
    }
    if ((now - begin) % interval == 0)
    {
      ++exposures;
      stamp += interval - kInterval;
      now -= kInterval;
      trained.assign(2, { exposures == 1 ? stamp + kInterval : trained[0].first, Eigen::Vector3d::Zero() });
      expose({ 0.0, 0.0, 0.0 });
    }
    if (const std::optional<RefinementRequest> request = monitor->takeRequest())
    {
      under_way.emplace(now + 60 * kMillisecond, request->id);
    }
    while (const std::optional<MotionDecision> decision = monitor->takeDecision())
    {
      EXPECT_EQ(decision->state, MotionState::OK) << decision->reason;
      EXPECT_LE(decision->wall_seconds, 0.1 + 1e-9);
      in_time += decision->source == PoseSource::REGISTERED ? 1 : 0;
    }
  }
  EXPECT_GT(in_time, 140) << "one in two exposures";
}

/// The tracks' own pose is known until they are lost, whether it is believed or not.
TEST_F(MonitorTest, TracksThatAreLostDuringAContradictionAreNoWayToTheNextVertebra)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  for (int i = 0; i < 10; ++i)
  {
    expectNone(registered({ 0.0, 0.0, 0.0 }, { 17.0, 0.0, 0.0 }), MotionState::INCONSISTENT, "contradict each other");
  }
  expectNone(registered({ 0.0, 0.0, 0.0 }, { 17.0, 0.0, 0.0 }, loseAll), MotionState::LOST, "correction is 17");
}

/// The tracks follow something else, all alike, and have gone 30 mm with it; the target has gone 3 mm. A registration
/// finds it from 14 mm away, as in the knee.
TEST_F(MonitorTest, TracksThatLeadNowhereAreFoundOutFromWhereTheTargetWas)
{
  const Eigen::Vector3d target(3.0, 0.0, 0.0), astray(30.0, 0.0, 0.0);
  for (const bool late : { false, true })
  {
    start();
    registered({ 0.0, 0.0, 0.0 });
    registered({ 0.0, 0.0, 0.0 });
    const auto look = [&](const Eigen::Vector3d& tracks)
    {
      expose(tracks);
      const RefinementRequest asked = request();
      const Eigen::Vector3d seed = asked.room_from_patient * scene.targetCentre() - scene.target;
      if (late)
      {
        monitor->onTime(*monitor->wakeAt());
      }
      const bool found = (seed - target).norm() < 14.0;
      monitor->onReply(found ? believed(asked.id, target) : doubted(asked.id), now + 150 * kMillisecond);
      return decision();
    };
    int exposures = 0;
    while (monitor->refinement().accepted() < 3 && exposures < 60)
    {
      look(astray);
      EXPECT_FALSE(monitor->gate().open() && exposures > 5) << exposures;
      ++exposures;
    }
    EXPECT_LT(exposures, 40) << "late " << late;
    for (std::size_t view = 0; view < 2 && !late; ++view)
    {
      EXPECT_TRUE(monitor->takeProposal()) << "view " << view << " is to learn its region anew";
    }
    look(astray);
    const MotionDecision after = look(astray);
    EXPECT_LT((after.room_from_patient * scene.targetCentre() - scene.target - target).norm(), 0.1) << "late " << late;
    EXPECT_EQ(after.state, MotionState::OK);
  }
}

TEST_F(MonitorTest, TheSecondRegistrationStartsFromTheFirstWhateverTheMethod)
{
  for (const PoseMethod method : { PoseMethod::REGISTRATION, PoseMethod::TRACKING_AND_REGISTRATION })
  {
    options.method = method;
    start();
    registered({ 0.0, 0.0, 0.0 });
    expectNone(registered({ 4.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 }, loseAll), MotionState::LOST, "has to confirm");
    expose({ 4.0, 0.0, 0.0 }, loseAll);
    const Eigen::Vector3d seed = request().room_from_patient * scene.targetCentre();
    EXPECT_LT((seed - scene.target - Eigen::Vector3d(4.0, 0.0, 0.0)).norm(), kExact) << poseMethodName(method);
  }
}

/// As of a result whose covariance is not known, which comes as zeros: the gate would take it for exact.
TEST_F(MonitorTest, ACovarianceThatIsNoneIsRefused)
{
  start();
  for (const double variance : { 0.0, -1e-4 })
  {
    for (int i = 0; i < 4; ++i)
    {
      expose({ 0.0, 0.0, 0.0 });
      RefinementReply reply = believed(request().id, { 0.0, 0.0, 0.0 });
      reply.covariance(2, 2) = variance;
      monitor->onReply(reply, now);
      expectPose(decision(), PoseSource::TRACKED, { 0.0, 0.0, 0.0 }, 1e-3);
    }
  }
  EXPECT_FALSE(monitor->gate().verification().verified());
}

TEST_F(MonitorTest, RegistrationsThatKnowLittleConfirmNothing)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  for (int i = 0; i < 10; ++i)
  {
    expose({ 0.0, 0.0, 0.0 }, loseAll);
    RefinementReply reply = believed(request().id, { i % 2 == 0 ? 17.0 : 0.0, 0.0, 0.0 });
    reply.covariance *= 1e6;
    monitor->onReply(reply, now);
    expectNone(decision(), MotionState::LOST, "");
  }
}

/// Later registrations correct what was tracked since the one before, and no pose from before that.
TEST_F(MonitorTest, ATrackedPoseIsCorrectedOnce)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  expose({ 1.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 1.0, 0.0, 0.0 }, 1e-3);
  const std::int64_t learnt = stamp;
  // Tissue that drifts by 0.5 mm an exposure.
  for (int i = 1; i <= 4; ++i)
  {
    registered({ 1.0, 0.0, 0.0 }, { 0.5 * i, 0.0, 0.0 });
  }
  trained.assign(2, { learnt, { 1.0, 0.0, 0.0 } });
  expose({ 1.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 1.5, 0.0, 0.0 }, 2e-3);
}

/// Tracks that count from the initial pose, which nothing has verified, are not verified by a registration without
/// them.
TEST_F(MonitorTest, TracksThatComeBackAreNotVerifiedByWhatWasFoundWithoutThem)
{
  for (const bool late : { false, true })
  {
    start();
    expose({ 0.0, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    decision();
    for (int i = 0; i < 3; ++i)
    {
      expose({ 0.0, 0.0, 0.0 }, loseAll);
      const RefinementRequest asked = request();
      if (late)
      {
        monitor->onTime(*monitor->wakeAt());
      }
      monitor->onReply(believed(asked.id, { 3.0, 0.0, 0.0 }), now + 150 * kMillisecond);
      decision();
    }
    for (int i = 0; i < 10; ++i)
    {
      expose({ 0.0, 0.0, 0.0 });
      monitor->onReply(doubted(request().id), now);
      expectNone(decision(), MotionState::NO_REFERENCE, "whose pose is not known");
    }
    EXPECT_FALSE(monitor->gate().open());
    expose({ 0.0, 0.0, 0.0 });
    monitor->onReply(believed(request().id, { 3.0, 0.0, 0.0 }), now);
    decision();
    expectPose(registered({ 0.0, 0.0, 0.0 }, { 3.0, 0.0, 0.0 }), PoseSource::REGISTERED, { 3.0, 0.0, 0.0 }, kExact);
    expose({ 0.5, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    expectPose(decision(), PoseSource::TRACKED, { 3.5, 0.0, 0.0 }, 1e-3);
  }
}

TEST_F(MonitorTest, ARegionThatIsMostlyOutsideTheImageIsNotLearnt)
{
  start();
  registered({ 0.0, 0.0, 0.0 });
  // The field ends 70 mm from the isocentre; a region is 28 mm wide.
  Eigen::Vector3d there = Eigen::Vector3d::Zero();
  for (; there.x() < 60.0; there.x() += 2.0)
  {
    registered(there);
  }
  for (int i = 0; i < 8; ++i)
  {
    registered(there, Eigen::Vector3d::Zero(), loseFirst);
    while (const std::optional<RegionProposal> proposal = monitor->takeProposal())
    {
      EXPECT_EQ(proposal->region & cv::Rect(0, 0, 512, 512), proposal->region);
      EXPECT_GT(2 * proposal->region.area(), 101 * 101);
      EXPECT_LT(proposal->region.area(), 101 * 101);
    }
  }
  for (; there.x() < 72.0; there.x() += 2.0)
  {
    registered(there);
  }
  for (int i = 0; i < 8; ++i)
  {
    registered(there, Eigen::Vector3d::Zero(), loseFirst);
    EXPECT_FALSE(monitor->takeProposal());
  }
}

/// The same events give the same decisions, to the last bit.
TEST_F(MonitorTest, IsDeterministic)
{
  const auto run = [this]
  {
    stamp = 1700000000000000000;
    now = 5000 * kMillisecond;
    start();
    std::vector<double> numbers;
    Random random(7);
    for (int i = 0; i < 50; ++i)
    {
      const Eigen::Vector3d motion = random.inCube(2.0);
      expose(motion, i % 7 == 6 ? Alter(loseFirst) : Alter());
      const RefinementRequest asked = request();
      monitor->onReply(i % 5 == 4 ? doubted(asked.id) : believed(asked.id, motion + random.inCube(0.1)), now);
      const MotionDecision decision = this->decision();
      numbers.insert(numbers.end(), decision.displacement.data(), decision.displacement.data() + 3);
      numbers.push_back(static_cast<double>(decision.state));
    }
    return numbers;
  };
  EXPECT_EQ(run(), run());
}

TEST_F(MonitorTest, OptionsAreChecked)
{
  options.deadline = -0.1;
  EXPECT_THROW(start(), std::invalid_argument);
  options.deadline = 0.0;
  EXPECT_NO_THROW(start());
  options.method = PoseMethod::REGISTRATION;
  EXPECT_THROW(start(), std::invalid_argument) << "no answer comes at once, so that no pose would ever";
  options.deadline = 0.1;
  options.refinement.mode = RefinementMode::NEVER;
  EXPECT_THROW(start(), std::invalid_argument);
  options.method = PoseMethod::TRACKING;
  EXPECT_NO_THROW(start());
  EXPECT_THROW(poseMethodFromName("guessing"), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
