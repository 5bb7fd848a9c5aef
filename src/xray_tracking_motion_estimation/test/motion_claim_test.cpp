#include <array>
#include <cmath>
#include <utility>

#include "monitor_test.h"

namespace xray_tracking
{
namespace
{
/// The patient is 12 mm from where the setup says, which tracks cannot know; registrations from there find nothing.
class ClaimTest : public MonitorTest
{
protected:
  void SetUp() override
  {
    start();
    for (int i = 0; i < 3; ++i)
    {
      unregistered({ 0.0, 0.0, 0.0 });
    }
  }

  MotionDecision unregistered(const Eigen::Vector3d& motion)
  {
    expose(motion);
    monitor->onReply(doubted(request().id), now);
    return decision();
  }

  /// @return what is asked
  RefinementRequest claim(const Eigen::Vector3d& where)
  {
    EXPECT_EQ(monitor->claim(moved(initialPose(), where), now), "");
    return request();
  }

  void expectRefusal(const std::string& words)
  {
    const std::optional<ClaimOutcome> outcome = monitor->takeOutcome();
    ASSERT_TRUE(outcome);
    EXPECT_NE(outcome->refusal.find(words), std::string::npos) << outcome->refusal;
  }

  const Eigen::Vector3d truth{ 12.0, 0.0, 0.0 };
};

TEST_F(ClaimTest, ABelievedRegistrationConfirmsIt)
{
  EXPECT_FALSE(monitor->gate().verification().verified());
  const RefinementRequest asked = claim({ 10.5, 1.0, 0.0 });
  EXPECT_EQ(asked.stamp, stamp);
  EXPECT_TRUE(asked.unverified);
  EXPECT_LT((asked.room_from_patient.translation() - moved(initialPose(), { 10.5, 1.0, 0.0 }).translation()).norm(),
            kExact);
  EXPECT_FALSE(monitor->takeOutcome());
  EXPECT_FALSE(monitor->gate().verification().verified());
  monitor->onReply(believed(asked.id, truth), now);
  const std::optional<ClaimOutcome> outcome = monitor->takeOutcome();
  ASSERT_TRUE(outcome);
  EXPECT_EQ(outcome->refusal, "");
  EXPECT_EQ(outcome->stamp, stamp);
  EXPECT_LT((outcome->room_from_patient.translation() - moved(initialPose(), truth).translation()).norm(), kExact);
  EXPECT_TRUE(monitor->gate().verification().verified()) << monitor->gate().text();
  EXPECT_FALSE(monitor->gate().open());
  EXPECT_FALSE(monitor->takeDecision());  // each exposure once
  // Tracks count from there, as do displacements from the planned place.
  expectPose(unregistered({ 0.5, 0.0, 0.0 }), PoseSource::TRACKED, { 12.5, 0.0, 0.0 }, 1e-3);
  EXPECT_EQ(GateReason::UNCERTAIN, monitor->gate().reason()) << "known to 0.52 mm";
  for (int i = 0; i < 7; ++i)
  {
    EXPECT_EQ(monitor->gate().open(), i > 4) << monitor->gate().text();
    expectPose(registered({ 0.5, 0.0, 0.0 }, truth), PoseSource::REGISTERED, { 12.5, 0.0, 0.0 }, kExact);
  }
}

TEST_F(ClaimTest, ARefusedOneLeavesEverythingAsItWas)
{
  monitor->restart("");
  trained.assign(2, { stamp + kInterval, Eigen::Vector3d::Zero() });
  for (int i = 0; i < 6; ++i)
  {
    registered({ 0.0, 0.0, 0.0 });
  }
  ASSERT_TRUE(monitor->gate().open()) << monitor->gate().text();
  const std::string before = monitor->gate().text();
  monitor->onReply(doubted(claim(truth).id), now);
  expectRefusal("the probability is 0.4");
  // Believed, but elsewhere than was stated: to the next vertebra it is not far.
  monitor->onReply(believed(claim(truth).id, truth + Eigen::Vector3d(5.1, 0.0, 0.0)), now);
  expectRefusal("5.1 mm and 0 degrees from where it was stated");
  RefinementReply nonsense = believed(claim(truth).id, truth);
  nonsense.room_from_patient.translation().x() = std::nan("");
  monitor->onReply(nonsense, now);
  expectRefusal("not finite");
  const RefinementRequest withdrawn = claim(truth);
  monitor->withdrawClaim();
  EXPECT_NE(monitor->claim(initialPose(), now), "");
  monitor->onReply(believed(withdrawn.id, truth), now);
  EXPECT_FALSE(monitor->takeOutcome());
  EXPECT_EQ(monitor->gate().text(), before);
  expectPose(unregistered({ 0.5, 0.0, 0.0 }), PoseSource::TRACKED, { 0.5, 0.0, 0.0 }, 1e-3);
  EXPECT_TRUE(monitor->gate().open());
  claim(truth);
  monitor->onTime(now + 2100 * kMillisecond);
  expectRefusal("no answer within 2 s");
  EXPECT_TRUE(monitor->gate().verification().verified());
}

/// As of images of different moments, or exchanged ones: what is found between such views is nowhere.
TEST_F(ClaimTest, ARegistrationWhoseViewsContradictEachOtherConfirmsNothing)
{
  for (const double pull : { 0.5, 8.0 })
  {
    RefinementReply reply = believed(claim(truth).id, truth);
    reply.pull = pull;
    monitor->onReply(reply, now);
    expectRefusal("views contradict each other");
    EXPECT_FALSE(monitor->gate().verification().verified());
    EXPECT_EQ(monitor->tracks().reference().translation(), initialPose().translation());
  }
}

TEST_F(ClaimTest, AfterARefusedOneItTakesTwoInARow)
{
  monitor->onReply(doubted(claim(truth).id), now);
  expectRefusal("0.4");
  monitor->onReply(believed(claim(truth).id, truth), now);
  EXPECT_EQ(monitor->takeOutcome()->refusal, "");
  EXPECT_FALSE(monitor->gate().verification().verified());
  EXPECT_NE(monitor->gate().text().find("stated"), std::string::npos) << monitor->gate().text();
  expectPose(registered({ 0.0, 0.0, 0.0 }, truth), PoseSource::REGISTERED, truth, kExact);
  EXPECT_TRUE(monitor->gate().verification().verified());
}

TEST_F(ClaimTest, ItWaitsForTheRegistrationThatIsUnderWay)
{
  expose({ 0.0, 0.0, 0.0 });
  const RefinementRequest first = request();
  EXPECT_EQ(monitor->claim(moved(initialPose(), truth), now), "");
  EXPECT_FALSE(monitor->takeRequest());
  monitor->onReply(doubted(first.id), now);
  decision();
  const RefinementRequest asked = request();
  EXPECT_EQ(asked.stamp, stamp - kInterval);  // the latest that had been decided
  // An exposure that comes meanwhile is registered from where the claim was confirmed.
  expose({ 0.5, 0.0, 0.0 });
  EXPECT_FALSE(monitor->takeRequest());
  EXPECT_FALSE(monitor->takeDecision());
  monitor->onReply(believed(asked.id, truth), now);
  const RefinementRequest next = request();
  EXPECT_EQ(next.stamp, stamp);
  EXPECT_LT((next.room_from_patient * scene.targetCentre() - scene.target - Eigen::Vector3d(12.5, 0.0, 0.0)).norm(),
            1e-3);
  monitor->onReply(believed(next.id, { 12.5, 0.0, 0.0 }), now);
  expectPose(decision(), PoseSource::REGISTERED, { 12.5, 0.0, 0.0 }, kExact);
}

TEST_F(ClaimTest, ViewsWhoseTemplatesThePoseDoesNotReachAreNotBelieved)
{
  // One view had lost its region when the claim was confirmed: what it counted from is void.
  expose({ 0.0, 0.0, 0.0 }, loseFirst);
  monitor->onReply(doubted(request().id), now);
  decision();
  monitor->onReply(believed(claim(truth).id, truth), now);
  EXPECT_EQ(monitor->takeOutcome()->refusal, "");
  expectNone(unregistered({ 0.0, 0.0, 0.0 }), MotionState::NO_REFERENCE, "detector_a was trained");
}

TEST_F(ClaimTest, WithoutTracksTheNextRegistrationIsConfirmedByIt)
{
  expose({ 0.0, 0.0, 0.0 }, loseAll);
  monitor->onReply(doubted(request().id), now);
  decision();
  monitor->onReply(believed(claim({ 11.0, 0.0, 0.0 }).id, truth), now);
  expose({ 0.2, 0.0, 0.0 }, loseAll);
  const RefinementRequest next = request();
  EXPECT_LT((next.room_from_patient.translation() - moved(initialPose(), truth).translation()).norm(), kExact);
  monitor->onReply(believed(next.id, { 12.2, 0.0, 0.0 }), now);
  expectPose(decision(), PoseSource::REGISTERED, { 12.2, 0.0, 0.0 }, kExact);
}

/// Trackers, which learn what they are asked to, and a registration, which finds the patient where it is: at `truth`
/// from the initial pose, and `motion` from there.
class RegionsAfterAClaimTest : public ClaimTest
{
protected:
  struct Case
  {
    PoseMethod method;
    RefinementMode mode;
    bool lost;  ///< the templates of the initial pose have lost what they showed there
  };

  void begin(const Case& how)
  {
    SCOPED_TRACE(poseMethodName(how.method));
    options.method = how.method;
    options.refinement.mode = how.mode;
    options.gate.verification.max_unverified_time = 3.0;  // the registration is asked for the regions' sake alone
    start();
    learnt = asked = { false, false };
    lost = how.lost;
    proposals = requests = 0;
    for (int i = 0; i < 3; ++i)
    {
      exposeBoth(false);
    }
    requests = 0;
  }

  void confirm(const Eigen::Vector3d& where)
  {
    EXPECT_EQ(monitor->claim(moved(initialPose(), where), now), "");
    monitor->onReply(believed(request().id, where), now);
    const std::optional<ClaimOutcome> outcome = monitor->takeOutcome();
    ASSERT_TRUE(outcome);
    EXPECT_EQ(outcome->refusal, "");
  }

  /// An exposure, whose registration is believed, or not. @return its decision
  MotionDecision exposeBoth(bool is_believed)
  {
    expose(motion,
           [this](std::vector<std::optional<TrackedView>>& views)
           {
             for (std::size_t i = 0; i < 2; ++i)
             {
               views[i] = tracked(i, learnt[i] ? Eigen::Vector3d(truth + motion) : motion);
               if (lost && !learnt[i])
               {
                 views[i]->state = RegionState::LOST;
               }
             }
           });
    for (std::size_t i = 0; i < 2; ++i)
    {
      if (std::exchange(asked[i], false) && trains)
      {
        trained[i] = { stamp, truth + motion };
        learnt[i] = true;
      }
    }
    if (const std::optional<RefinementRequest> request = monitor->takeRequest())
    {
      ++requests;
      monitor->onReply(is_believed ? believed(request->id, truth + motion) : doubted(request->id), now);
    }
    while (const std::optional<RegionProposal> proposal = monitor->takeProposal())
    {
      ++proposals;
      asked[proposal->view] = true;
      expectBox(*proposal);
    }
    return decision();
  }

  void expectBox(const RegionProposal& proposal) const
  {
    Eigen::AlignedBox2d seen;
    for (int corner = 0; corner < 8; ++corner)
    {
      const Eigen::Vector3d point = targetBox().corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner));
      seen.extend(pixelOf(scene.views[proposal.view], moved(initialPose(), truth + motion) * point));
    }
    const cv::Rect& region = proposal.region;
    EXPECT_LT((Eigen::Vector2d(region.x, region.y) - seen.min()).cwiseAbs().maxCoeff(), 1.0);
    EXPECT_LT((Eigen::Vector2d(region.width, region.height) - seen.sizes()).cwiseAbs().maxCoeff(), 1.5);
  }

  void expectThere(const MotionDecision& decision, PoseSource source)
  {
    EXPECT_EQ(decision.state, MotionState::OK) << decision.reason;
    EXPECT_EQ(decision.source, source) << decision.not_registered;
    EXPECT_LT((decision.displacement - truth - motion).norm(), 5e-3) << decision.displacement.transpose();
  }

  Eigen::Vector3d motion = Eigen::Vector3d::Zero();
  std::array<bool, 2> learnt{}, asked{};
  bool lost = false, trains = true;
  int proposals = 0, requests = 0;
};

TEST_F(RegionsAfterAClaimTest, AreLearntWhereTheTargetIsWhateverTheMethodAndTheMode)
{
  for (const PoseMethod method :
       { PoseMethod::TRACKING, PoseMethod::REGISTRATION, PoseMethod::TRACKING_AND_REGISTRATION })
  {
    for (const RefinementMode mode : { RefinementMode::ON_DEMAND, RefinementMode::EVERY_FRAME })
    {
      for (const bool are_lost : { false, true })
      {
        SCOPED_TRACE(std::string(poseMethodName(method)) + (mode == RefinementMode::ON_DEMAND ? " on demand" : "") +
                     (are_lost ? ", lost" : ""));
        motion.setZero();
        begin({ method, mode, are_lost });
        confirm(truth);
        for (int i = 0; i < 5; ++i)
        {
          motion += Eigen::Vector3d(0.1, -0.1, 0.05);
          const MotionDecision decision = exposeBoth(true);
          if (decision.state == MotionState::OK)
          {
            expectThere(decision, decision.source);
          }
          // The old templates are of use until the new ones are; from then on a registration is not asked for by
          // itself.
          const bool unasked = decision.state == MotionState::UNREGISTERED && learnt[0] && learnt[1];
          EXPECT_TRUE(are_lost || unasked || decision.state == MotionState::OK) << i << ": " << decision.reason;
        }
        EXPECT_EQ(proposals, 2);
        EXPECT_TRUE(learnt[0] && learnt[1]);
        // From here on the tracks do alone.
        requests = 0;
        motion += Eigen::Vector3d(0.5, 0.2, -0.3);
        const MotionDecision decision = exposeBoth(false);
        EXPECT_EQ(requests, mode == RefinementMode::ON_DEMAND ? 0 : 1);
        if (method == PoseMethod::REGISTRATION)
        {
          expectNone(decision, MotionState::UNREGISTERED, "");
          EXPECT_TRUE(monitor->demandRefinement());
          expectThere(exposeBoth(true), PoseSource::REGISTERED);
        }
        else
        {
          expectThere(decision, PoseSource::TRACKED);
        }
        EXPECT_EQ(proposals, 2);
      }
    }
  }
}

TEST_F(RegionsAfterAClaimTest, AreAskedForOnceASecondUntilTheyAreLearnt)
{
  begin({ PoseMethod::TRACKING_AND_REGISTRATION, RefinementMode::ON_DEMAND, false });
  confirm(truth);
  trains = false;
  for (int i = 1; i <= 13; ++i)
  {
    expectThere(exposeBoth(true), PoseSource::REGISTERED);
    EXPECT_EQ(proposals, 2 * (1 + (i - 1) / 5)) << i;
  }
  // One that somebody else had learn is as good.
  trained[0] = { stamp, truth };
  learnt[0] = true;
  exposeBoth(true);
  proposals = 0;
  for (int i = 0; i < 10; ++i)
  {
    exposeBoth(true);
  }
  EXPECT_EQ(proposals, 2);
}

TEST_F(RegionsAfterAClaimTest, AreLearntWhereTheNodeHasDiedMeanwhileToo)
{
  begin({ PoseMethod::TRACKING_AND_REGISTRATION, RefinementMode::ON_DEMAND, false });
  confirm(truth);
  die();
  for (int i = 0; i < 4; ++i)
  {
    const MotionDecision decision = exposeBoth(true);
    expectThere(decision, decision.source);
  }
  EXPECT_EQ(proposals, 2);
  EXPECT_TRUE(learnt[0] && learnt[1]);
  requests = 0;
  expectThere(exposeBoth(true), PoseSource::TRACKED);
  EXPECT_EQ(requests, 0);
}

TEST_F(RegionsAfterAClaimTest, StayWhereTheyCoverTheTarget)
{
  begin({ PoseMethod::TRACKING_AND_REGISTRATION, RefinementMode::ON_DEMAND, false });
  confirm({ 2.0, 0.0, 0.0 });
  for (int i = 0; i < 5; ++i)
  {
    const MotionDecision decision = exposeBoth(false);
    EXPECT_EQ(decision.source, PoseSource::TRACKED);
    EXPECT_LT((decision.displacement - Eigen::Vector3d(2.0, 0.0, 0.0)).norm(), 1e-3);
  }
  EXPECT_EQ(proposals, 0);
  EXPECT_LE(requests, 1);
}

TEST_F(ClaimTest, WhatCannotBeLookedAtIsSaid)
{
  RigidTransform bad = initialPose();
  bad.translation().y() = std::nan("");
  EXPECT_NE(monitor->claim(bad, now).find("finite"), std::string::npos);
  bad = initialPose();
  bad.linear() *= 1.1;
  EXPECT_NE(monitor->claim(bad, now).find("rotation"), std::string::npos);
  const Eigen::Vector3d behind(0.0, 0.0, 2.0 * kSourceToIsocentre);
  EXPECT_NE(monitor->claim(moved(initialPose(), behind), now).find("in front of the source"), std::string::npos);
  EXPECT_FALSE(monitor->takeRequest());
  claim(truth);
  EXPECT_NE(monitor->claim(initialPose(), now).find("earlier"), std::string::npos);
  monitor->restart("");
  expectRefusal("start again");
  EXPECT_NE(monitor->claim(initialPose(), now).find("no exposure"), std::string::npos);
  options.method = PoseMethod::TRACKING;
  options.refinement.mode = RefinementMode::NEVER;
  start();
  expose({ 0.0, 0.0, 0.0 });
  EXPECT_NE(monitor->claim(initialPose(), now).find("never"), std::string::npos);
}
}  // namespace
}  // namespace xray_tracking
