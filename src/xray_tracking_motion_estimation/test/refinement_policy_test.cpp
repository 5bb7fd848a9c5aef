#include "xray_tracking_motion_estimation/refinement_policy.h"

#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "xray_tracking_motion_estimation/motion_traces.h"
#include "xray_tracking_motion_estimation/pose_history.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kInterval = 33 * kMillisecond;

Vector6d moved(double x, double y = 0.0, double z = 0.0, double rotation_y = 0.0)
{
  return (Vector6d() << x, y, z, 0.0, rotation_y, 0.0).finished();
}

/// A registration that is asked and answers when the test says so. Exposures come every 33 ms.
class RefinementTest : public testing::Test
{
protected:
  RefinementPolicy makePolicy() { return RefinementPolicy(options, traceTarget()); }

  RefinementSeed exposureAt(const Vector6d& motion, double disagreement = 0.3)
  {
    now += kInterval;
    const RigidTransform pose = tracePose(motion);
    Vector6d variances;
    variances << Eigen::Vector3d::Constant(tracked_variance), 3e-4, 3e-4, 3e-4;
    return { now + 1000000 * kMillisecond, pose, covarianceAtOrigin(pose, variances.asDiagonal()), disagreement };
  }

  /// Without a tracked pose, the last one `since` ago [s].
  RefinementSeed lostAt(const Vector6d& motion, double since)
  {
    RefinementSeed exposure = exposureAt(motion);
    exposure.tracked = false;
    exposure.since = since;
    return exposure;
  }

  /// Asks about the exposure if it is due and nothing is under way.
  void expose(RefinementPolicy& policy, const RefinementSeed& exposure, bool unverified = false)
  {
    if (policy.due(exposure, now) && !policy.pending())
    {
      requests.push_back(policy.ask(exposure, unverified, now));
    }
  }

  RefinementReply answer(const Vector6d& refined_motion) const
  {
    RefinementReply reply;
    reply.id = requests.back().id;
    reply.success = true;
    reply.room_from_patient = tracePose(refined_motion);
    Vector6d variances;
    variances << 0.01, 0.01, 0.01, 1e-5, 1e-5, 1e-5;
    reply.covariance = covarianceAtOrigin(reply.room_from_patient, variances.asDiagonal());
    reply.seed_similarity = 0.8;
    reply.similarity = 0.9;
    return reply;
  }

  /// Asks and has the answer judged.
  RefinementPolicy::Judgement refine(RefinementPolicy& policy, const RefinementSeed& exposure,
                                     const Vector6d& refined_motion)
  {
    expose(policy, exposure);
    return policy.judge(answer(refined_motion));
  }

  RefinementReply failure() const
  {
    RefinementReply reply;
    reply.id = requests.back().id;
    reply.text = "flat optimum";
    return reply;
  }

  /// Where along x, from its start, the target is looked for next [mm], while tracks lead to `tracked`.
  double nextStart(RefinementPolicy& policy, double tracked, bool unverified = true)
  {
    expose(policy, exposureAt(moved(tracked)), unverified);
    return (requests.back().room_from_patient * traceTarget() - tracePose(moved(0.0)) * traceTarget()).x();
  }

  /// A policy whose tracks have slipped by 30 mm since the registration of a target at 2 mm, and led to three that were
  /// not believed.
  RefinementPolicy astray()
  {
    options.mode = RefinementMode::EVERY_FRAME;
    RefinementPolicy policy = makePolicy();
    EXPECT_TRUE(refine(policy, exposureAt(moved(2.0)), moved(2.0)).refinement);
    for (int i = 0; i < 3; ++i)
    {
      EXPECT_NEAR(nextStart(policy, 30.0), 30.0, 1e-6);
      policy.judge(failure());
    }
    now += 10000 * kMillisecond;
    return policy;
  }

  /// How many of 100 exposures at rest are asked for if every answer comes before the next one.
  std::size_t requestsOf100(RefinementPolicy& policy)
  {
    for (int i = 0; i < 100; ++i)
    {
      expose(policy, exposureAt(moved(0.0)));
      if (policy.pending())
      {
        policy.judge(answer(moved(0.0)));
      }
    }
    return requests.size();
  }

  /// Asks, spoils the answer, and expects a refusal that names `what`.
  void expectRefused(const std::string& what, const std::function<void(RefinementReply&)>& spoil,
                     RefinementVerdict verdict = RefinementVerdict::REFUSED)
  {
    options.mode = RefinementMode::EVERY_FRAME;
    RefinementPolicy policy = makePolicy();
    expose(policy, exposureAt(moved(1.0)));
    RefinementReply reply = answer(moved(1.1));
    spoil(reply);
    const RefinementPolicy::Judgement judgement = policy.judge(reply);
    EXPECT_FALSE(judgement.refinement);
    EXPECT_EQ(judgement.verdict, verdict);
    EXPECT_NE(judgement.reason.find(what), std::string::npos) << judgement.reason;
    EXPECT_EQ(policy.lastRefusal(), judgement.reason);
    EXPECT_EQ(policy.refused(), 1u);
    // The same answer unspoilt is good.
    EXPECT_TRUE(refine(policy, exposureAt(moved(1.0)), moved(1.1)).refinement) << policy.lastRefusal();
  }

  RefinementPolicyOptions options;
  double tracked_variance = 1.04;  ///< 1 mm of tissue and 0.2 mm of the tracks [mm^2]
  std::vector<RefinementRequest> requests;
  std::int64_t now = 0;
};

TEST_F(RefinementTest, LooksWhereTheTargetWasIfTracksAreNotBelieved)
{
  RefinementPolicy policy = astray();
  EXPECT_NEAR(nextStart(policy, 30.0), 2.0, 1e-6);
  policy.judge(failure());
  EXPECT_NEAR(nextStart(policy, 31.0), 31.0, 1e-6) << "tracks may be right for all that";
  policy.judge(failure());
  EXPECT_NEAR(nextStart(policy, 32.0), 2.0, 1e-6);
  const RefinementPolicy::Judgement first = policy.judge(answer(moved(5.0)));
  EXPECT_EQ(first.verdict, RefinementVerdict::UNCONFIRMED);
  EXPECT_NEAR(nextStart(policy, 33.0), 2.0, 1e-6) << "another one has to find it, too";
  const RefinementPolicy::Judgement second = policy.judge(answer(moved(5.2)));
  ASSERT_TRUE(second.refinement) << second.reason;
  EXPECT_FALSE(second.refinement->tracked) << "tracks say nothing of it";
  EXPECT_TRUE(second.refinement->outvoted) << "what they follow is to be learnt anew";
  EXPECT_NEAR(nextStart(policy, 5.3), 5.3, 1e-6) << "tracks count from there";
}

TEST_F(RefinementTest, LooksNowhereElseWhileTracksAreVerified)
{
  RefinementPolicy policy = astray();
  EXPECT_NEAR(nextStart(policy, 30.0, false), 30.0, 1e-6);
}

TEST_F(RefinementTest, LooksNowhereElseIfWhatItFindsIsBelieved)
{
  RefinementPolicy policy = astray();
  EXPECT_NEAR(nextStart(policy, 30.0), 2.0, 1e-6);
  policy.judge(failure());
  EXPECT_NEAR(nextStart(policy, 30.0), 30.0, 1e-6);
  policy.judge(answer(moved(30.1)));
  EXPECT_NEAR(nextStart(policy, 30.0), 30.0, 1e-6);
}

TEST_F(RefinementTest, WhereTheTargetWasNobodyGetsToTheNextVertebra)
{
  RefinementPolicy policy = astray();
  for (int i = 0; i < 6; ++i)
  {
    expose(policy, exposureAt(moved(30.0)), true);
    const bool where_it_was = i % 2 == 0;
    const RefinementPolicy::Judgement judgement = policy.judge(where_it_was ? answer(moved(-10.0)) : failure());
    EXPECT_FALSE(judgement.refinement);
    EXPECT_EQ(judgement.verdict, RefinementVerdict::REFUSED) << judgement.reason;
  }
}

TEST_F(RefinementTest, NeverAsks)
{
  RefinementPolicy policy = makePolicy();
  EXPECT_FALSE(policy.demand());
  EXPECT_EQ(requestsOf100(policy), 0u);
}

TEST_F(RefinementTest, AsksForEveryFrame)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  EXPECT_EQ(requestsOf100(policy), 100u);
  EXPECT_EQ(policy.accepted(), 100u);
}

TEST_F(RefinementTest, AsksForEveryNth)
{
  options.mode = RefinementMode::EVERY_N;
  options.every_n = 7;
  RefinementPolicy policy = makePolicy();
  EXPECT_EQ(requestsOf100(policy), 14u);
  EXPECT_EQ(requests[1].stamp - requests[0].stamp, 7 * kInterval);
}

TEST_F(RefinementTest, AsksOnDemand)
{
  options.mode = RefinementMode::ON_DEMAND;
  RefinementPolicy policy = makePolicy();
  EXPECT_EQ(requestsOf100(policy), 0u);
  EXPECT_TRUE(policy.demand());
  EXPECT_EQ(requestsOf100(policy), 1u);
}

TEST_F(RefinementTest, ADemandWaitsUntilItIsAskedFor)
{
  options.mode = RefinementMode::ON_DEMAND;
  RefinementPolicy policy = makePolicy();
  policy.demand();
  EXPECT_TRUE(policy.due(exposureAt(moved(0.0)), now));
  EXPECT_TRUE(policy.due(exposureAt(moved(0.0)), now)) << "nothing was asked";
  policy.ask(exposureAt(moved(0.0)), false, now);
  EXPECT_FALSE(policy.due(exposureAt(moved(0.0)), now));
}

TEST_F(RefinementTest, AsksOnDrift)
{
  options.mode = RefinementMode::ON_DRIFT;
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(0.0)));
  expose(policy, exposureAt(moved(2.9)));
  EXPECT_TRUE(requests.empty());
  expose(policy, exposureAt(moved(3.1)));
  ASSERT_EQ(requests.size(), 1u);
  EXPECT_TRUE(requests[0].room_from_patient.isApprox(tracePose(moved(3.1))));
  ASSERT_TRUE(policy.judge(answer(moved(3.0))).refinement);

  // Counted from there, by motion, rotation and residual.
  expose(policy, exposureAt(moved(5.9, 0.0, 0.0, 0.019)));
  EXPECT_EQ(requests.size(), 1u);
  expose(policy, exposureAt(moved(5.9, 0.0, 0.0, 0.021)));
  EXPECT_EQ(requests.size(), 2u);
  ASSERT_TRUE(policy.judge(answer(moved(5.9))).refinement);
  expose(policy, exposureAt(moved(5.9), 1.6));
  EXPECT_EQ(requests.size(), 3u);
}

TEST_F(RefinementTest, DriftDoesNotAskAgainAtOnceAfterARefusal)
{
  options.mode = RefinementMode::ON_DRIFT;
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(0.0)));
  for (int i = 0; i < 300; ++i)  // 10 s
  {
    expose(policy, exposureAt(moved(4.0)));
    if (policy.pending())
    {
      EXPECT_EQ(policy.judge(failure()).verdict, RefinementVerdict::REFUSED);
    }
  }
  EXPECT_EQ(requests.size(), 5u);  // every 2 s
}

TEST_F(RefinementTest, HasOneRequestUnderWayAndGivesUp)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(0.0)));
  EXPECT_THROW(policy.ask(exposureAt(moved(0.0)), false, now), std::logic_error);
  const RefinementReply late = answer(moved(0.1));
  EXPECT_FALSE(policy.tick(now + 1000 * kMillisecond));
  EXPECT_TRUE(policy.tick(now + 2100 * kMillisecond));
  EXPECT_EQ(policy.timeouts(), 1u);
  EXPECT_THROW(policy.judge(late), std::logic_error);
  expose(policy, exposureAt(moved(0.0)));
  EXPECT_NE(policy.pending(), late.id);
  EXPECT_THROW(policy.judge(late), std::logic_error) << "nor does it answer the next request";
  EXPECT_TRUE(policy.judge(answer(moved(0.1))).refinement);
}

TEST_F(RefinementTest, ARequestFromBeforeAResetIsVoid)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(0.0)));
  policy.reset();
  EXPECT_FALSE(policy.pending());
  EXPECT_EQ(policy.accepted(), 0u);
}

TEST_F(RefinementTest, RefusesFailures)
{
  expectRefused("no volume",
                [](RefinementReply& reply)
                {
                  reply.success = false;
                  reply.text = "no volume";
                });
}

TEST_F(RefinementTest, RefusesNumbersThatAreNone)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  expectRefused("not finite", [&](RefinementReply& reply) { reply.room_from_patient.translation().x() = nan; });
  expectRefused("not finite", [&](RefinementReply& reply) { reply.room_from_patient.linear() *= 2.0; });
  expectRefused("not finite", [&](RefinementReply& reply) { reply.covariance(3, 3) = nan; });
  expectRefused("not finite", [&](RefinementReply& reply) { reply.similarity = nan; });
  expectRefused("similarity", [&](RefinementReply& reply) { reply.seed_similarity = nan; });
}

TEST_F(RefinementTest, RefusesLargeCorrections)
{
  expectRefused(
      "correction", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(6.1)); },
      RefinementVerdict::CONTRADICTS);
  expectRefused(
      "correction", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(1.0, 0.0, 0.0, 0.08)); },
      RefinementVerdict::CONTRADICTS);
}

TEST_F(RefinementTest, RefusesWhatIsNoBetterMatch)
{
  expectRefused("similarity", [](RefinementReply& reply) { reply.similarity = 0.79; });
  options.min_similarity = 0.85;
  expectRefused("similarity", [](RefinementReply& reply) { reply.similarity = 0.84; });
}

// As similar but for noise: the seed was right.
TEST_F(RefinementTest, EqualSimilaritiesAgree)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(1.0)));
  RefinementReply reply = answer(moved(1.1));
  reply.seed_similarity = 0.92124;
  reply.similarity = 0.921194;
  EXPECT_TRUE(policy.judge(reply).refinement) << policy.lastRefusal();
}

// Where the tracks say nothing there is nothing to contradict: the next registration has to find the same.
TEST_F(RefinementTest, WithoutTracksItTakesTwoThatAgree)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  RefinementPolicy::Judgement judgement = refine(policy, lostAt(moved(0.5), 0.3), moved(7.0));
  EXPECT_EQ(judgement.verdict, RefinementVerdict::UNCONFIRMED);
  EXPECT_TRUE(requests[0].room_from_patient.isApprox(tracePose(moved(0.5)), 1e-12));
  judgement = refine(policy, lostAt(moved(0.5), 0.333), moved(7.3));
  EXPECT_TRUE(requests[1].room_from_patient.isApprox(tracePose(moved(7.0)), 1e-12)) << "from where it found it";
  ASSERT_TRUE(judgement.refinement) << judgement.reason;
  EXPECT_FALSE(judgement.refinement->tracked);
  EXPECT_TRUE(judgement.refinement->refined.isApprox(tracePose(moved(7.3)), 1e-12));
  // A failure in between, and it takes two again.
  expose(policy, lostAt(moved(7.3), 0.033));
  EXPECT_EQ(policy.judge(failure()).reason, "flat optimum");
  EXPECT_EQ(refine(policy, lostAt(moved(7.3), 0.066), moved(7.4)).verdict, RefinementVerdict::UNCONFIRMED);
  EXPECT_TRUE(refine(policy, lostAt(moved(7.3), 0.1), moved(7.5)).refinement);
}

// 17 mm to the next vertebra, which a target at 15 mm/s and a correction of 5 mm would reach after 0.8 s, but nobody
// gets farther than 10 mm.
TEST_F(RefinementTest, WithoutTracksNobodyGetsFartherThanATargetMoves)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  for (int i = 1; i <= 5; ++i)
  {
    const RefinementPolicy::Judgement judgement = refine(policy, lostAt(moved(0.0), 0.1 * i), moved(17.0));
    EXPECT_EQ(judgement.verdict, RefinementVerdict::REFUSED);
    EXPECT_NE(judgement.reason.find("correction is 17"), std::string::npos) << judgement.reason;
  }
  EXPECT_EQ(refine(policy, lostAt(moved(0.0), 0.25), moved(9.0)).verdict, RefinementVerdict::REFUSED);
  for (const double since : { 0.81, 2.0, 1e6 })
  {
    for (const double way : { 17.0, 10.1 })
    {
      const RefinementPolicy::Judgement judgement = refine(policy, lostAt(moved(0.0), since), moved(way));
      EXPECT_EQ(judgement.verdict, RefinementVerdict::REFUSED);
      EXPECT_NE(judgement.reason.find("expected at most 10 mm"), std::string::npos) << judgement.reason;
    }
  }
  EXPECT_TRUE(refine(policy, lostAt(moved(0.0), 0.34), moved(9.9)).refinement) << "the ones before agree with it";
}

// Two that are farther apart than a target moves meanwhile do not agree: 0.5 mm, what registrations spread by, and
// three of their deviations of 0.14 mm.
TEST_F(RefinementTest, WithoutTracksRegistrationsElsewhereConfirmNothing)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  EXPECT_EQ(refine(policy, lostAt(moved(0.0), 0.1), moved(0.0)).verdict, RefinementVerdict::UNCONFIRMED);
  EXPECT_EQ(refine(policy, lostAt(moved(0.0), 0.133), moved(1.7)).verdict, RefinementVerdict::UNCONFIRMED);
  EXPECT_TRUE(refine(policy, lostAt(moved(0.0), 0.166), moved(0.0)).verdict == RefinementVerdict::UNCONFIRMED);
  EXPECT_TRUE(refine(policy, lostAt(moved(0.0), 0.2), moved(1.7)).verdict == RefinementVerdict::UNCONFIRMED);
  EXPECT_TRUE(refine(policy, lostAt(moved(0.0), 0.233), moved(1.5)).refinement);
}

// Tracks that hold on to something else: registrations that agree with each other outweigh them, up to 10 mm.
TEST_F(RefinementTest, ThreeInARowThatAgreeOutweighTheTracks)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(0.1)).refinement);
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.0)).verdict, RefinementVerdict::CONTRADICTS);
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.1)).verdict, RefinementVerdict::CONTRADICTS);
  const RefinementPolicy::Judgement judgement = refine(policy, exposureAt(moved(0.0)), moved(7.2));
  ASSERT_TRUE(judgement.refinement) << judgement.reason;
  EXPECT_TRUE(judgement.refinement->tracked);
  for (int i = 0; i < 10; ++i)
  {
    EXPECT_EQ(refine(policy, exposureAt(moved(7.2)), moved(17.5)).verdict, RefinementVerdict::CONTRADICTS);
  }
  // Not if one of them fails or is elsewhere.
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.0)).verdict, RefinementVerdict::CONTRADICTS);
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.0)).verdict, RefinementVerdict::CONTRADICTS);
  expose(policy, exposureAt(moved(0.0)));
  policy.judge(failure());
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.0)).verdict, RefinementVerdict::CONTRADICTS);
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(-7.0)).verdict, RefinementVerdict::CONTRADICTS);
  EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(7.0)).verdict, RefinementVerdict::CONTRADICTS);
}

// Combined deviations: 0.22 mm and 0.0176 rad. chi-square of 6 degrees of freedom is 22.46 at 0.001, so that a single
// axis may be off by 4.74 of them: 1.06 mm, 0.083 rad.
TEST_F(RefinementTest, RefusesWhatContradictsTheTracks)
{
  // With 1 mm of tissue 4.74 * sqrt(0.05 + 1) = 4.86 mm.
  expectRefused(
      "contradicts", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(5.9)); },
      RefinementVerdict::CONTRADICTS);
  {
    RefinementPolicy policy = makePolicy();
    EXPECT_TRUE(refine(policy, exposureAt(moved(1.0)), moved(5.8)).refinement) << policy.lastRefusal();
  }
  tracked_variance = 0.04;
  expectRefused(
      "contradicts", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(2.08)); },
      RefinementVerdict::CONTRADICTS);
  RefinementPolicy policy = makePolicy();
  EXPECT_TRUE(refine(policy, exposureAt(moved(1.0)), moved(2.04)).refinement) << policy.lastRefusal();
  // The covariance is the target's, however long the arm to the origin: two degrees are within the bounds.
  EXPECT_TRUE(refine(policy, exposureAt(moved(1.0)), moved(1.0, 0.0, 0.0, 0.035)).refinement) << policy.lastRefusal();
}

// Tissue that carries tracks away is no reason to doubt registrations that go on as they were; the first one is.
TEST_F(RefinementTest, RegistrationsThatFollowEachOtherOutweighWhatTracksAreUncertainBy)
{
  options.mode = RefinementMode::EVERY_FRAME;
  tracked_variance = 0.04;
  RefinementPolicy policy = makePolicy();
  EXPECT_EQ(refine(policy, exposureAt(moved(2.0)), moved(0.0)).verdict, RefinementVerdict::CONTRADICTS);
  EXPECT_TRUE(refine(policy, exposureAt(moved(0.1)), moved(0.1)).refinement);
  EXPECT_TRUE(refine(policy, exposureAt(moved(1.4)), moved(0.2)).refinement) << policy.lastRefusal();
  EXPECT_EQ(refine(policy, exposureAt(moved(5.4)), moved(0.3)).verdict, RefinementVerdict::CONTRADICTS);
  // Not if they are so far apart in time that the target can have gone anywhere.
  now += 400 * kMillisecond;
  EXPECT_EQ(refine(policy, exposureAt(moved(2.0)), moved(0.4)).verdict, RefinementVerdict::CONTRADICTS);
}

// As of views made at different times, however well the tracks, which count from the last registration, agree.
TEST_F(RefinementTest, RefusesViewsThatContradictEachOther)
{
  for (const double bad : { 0.41, std::nan("") })
  {
    requests.clear();
    expectRefused(
        "views contradict each other", [&](RefinementReply& reply) { reply.pull = bad; },
        RefinementVerdict::CONTRADICTS);
  }
  RefinementPolicy policy = makePolicy();
  expose(policy, exposureAt(moved(0.0)));
  RefinementReply reply = answer(moved(0.0));
  reply.pull = 0.39;
  EXPECT_TRUE(policy.judge(reply).refinement) << policy.lastRefusal();
  // Three in a row are as wrong.
  for (int i = 0; i < 5; ++i)
  {
    expose(policy, exposureAt(moved(0.0)));
    reply = answer(moved(0.0));
    reply.pull = 0.8;
    EXPECT_EQ(policy.judge(reply).verdict, RefinementVerdict::CONTRADICTS);
  }
}

// Of 0.2 mm standard deviation between the two, 0.7 mm of spread and 5 mm/s of tissue, 0.42 + 0.7 + 0.17 mm may be a
// registration's own in a thirtieth of a second, whatever tissue makes the tracks uncertain by in the long run.
TEST_F(RefinementTest, RefusesALeapThatTheTracksHaveNotSeen)
{
  options.mode = RefinementMode::EVERY_FRAME;
  {
    RefinementPolicy policy = makePolicy();
    EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(3.0)).refinement) << "the first one has none before it";
    EXPECT_EQ(refine(policy, exposureAt(moved(3.0)), moved(6.0)).verdict, RefinementVerdict::CONTRADICTS);
    EXPECT_NE(policy.lastRefusal().find("leaps"), std::string::npos) << policy.lastRefusal();
    EXPECT_TRUE(refine(policy, exposureAt(moved(3.0)), moved(3.1)).refinement) << "the next good one is believed";
    // The target has moved so.
    EXPECT_TRUE(refine(policy, exposureAt(moved(6.1)), moved(6.1)).refinement) << policy.lastRefusal();
    // The tracks have alone; or the target has, and the registration is off by as much the other way.
    EXPECT_EQ(refine(policy, exposureAt(moved(9.1)), moved(6.1)).verdict, RefinementVerdict::CONTRADICTS);
  }
  {
    // Three in a row outweigh the tracks.
    RefinementPolicy policy = makePolicy();
    EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(0.0)).refinement);
    EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(3.0)).verdict, RefinementVerdict::CONTRADICTS);
    EXPECT_EQ(refine(policy, exposureAt(moved(0.0)), moved(3.0)).verdict, RefinementVerdict::CONTRADICTS);
    EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(3.0)).refinement) << policy.lastRefusal();
  }
  // In a second tissue makes as much.
  RefinementPolicy policy = makePolicy();
  EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(0.0)).refinement);
  now += 1000 * kMillisecond;
  EXPECT_TRUE(refine(policy, exposureAt(moved(0.0)), moved(3.0)).refinement) << policy.lastRefusal();
}

// Tracks measure the target's translation in the room and, if at all, its rotation since the reference; the reference
// was wrong by a rotation and a translation. The answer comes after the target has moved on.
TEST(Refinement, IsCarriedForwardByTheMotionSince)
{
  const MotionTrace trace = breathing(4, 20.0);
  const RigidTransform true_reference = tracePose(Vector6d::Zero());
  const Eigen::Vector3d centre = true_reference * traceTarget();
  Twist mistake;
  mistake << 0.01, -0.03, 0.02, 1.0, -2.0, 0.5;
  const RigidTransform wrong_reference = motionAbout(centre, mistake) * true_reference;
  const auto poseOf = [&](const RigidTransform& reference, double time, bool rotates)
  {
    const Vector6d motion = trace(time);
    RigidTransform pose = reference;
    pose.linear() =
        rotationFromVector(rotates ? Eigen::Vector3d(motion.tail<3>()) : Eigen::Vector3d::Zero()) * reference.linear();
    pose.translation() = reference * traceTarget() + motion.head<3>() - pose.linear() * traceTarget();
    return pose;
  };

  for (const bool rotates : { false, true })
  {
    const double then = 5.0;
    const Refinement refinement{ 0, poseOf(wrong_reference, then, rotates), poseOf(true_reference, then, rotates),
                                 PoseCovariance::Zero() };
    double worst_of_multiplied = 0.0;
    for (double time = 0.0; time < 20.0; time += 0.1)
    {
      const RigidTransform tracked = poseOf(wrong_reference, time, rotates);
      const RigidTransform truth = poseOf(true_reference, time, rotates);
      EXPECT_TRUE(refinement.carry(tracked, traceTarget()).isApprox(truth, 1e-12)) << time;
      const RigidTransform multiplied = refinement.refined * refinement.tracked->inverse() * tracked;
      worst_of_multiplied = std::max(worst_of_multiplied, (multiplied * traceTarget() - truth * traceTarget()).norm());
    }
    // The target moves 10 mm, the correction turns by 2 degrees.
    EXPECT_GT(worst_of_multiplied, 0.2);
  }
}

TEST(Refinement, ReanchorsAllEarlierExposures)
{
  PoseHistory history(10);
  history.add({ 1, tracePose(moved(0.0)), false });
  history.add({ 2, tracePose(moved(4.0)), false });
  const Refinement refinement{ 2, tracePose(moved(4.0)), tracePose(moved(4.5, 0.2, 0.0, 0.02)),
                               PoseCovariance::Zero() };
  history.correctTracked([&](const RigidTransform& pose) { return refinement.carry(pose, traceTarget()); });
  EXPECT_TRUE(history.at(2)->room_from_patient.isApprox(refinement.refined, 1e-12));
  EXPECT_TRUE(history.at(1)->room_from_patient.isApprox(tracePose(moved(0.5, 0.2, 0.0, 0.02)), 1e-12));
}

TEST(RefinementPolicyOptions, AreChecked)
{
  const auto refused = [](const std::function<void(RefinementPolicyOptions&)>& spoil, const std::string& key)
  {
    RefinementPolicyOptions options;
    spoil(options);
    try
    {
      options.validate();
      return false;
    }
    catch (const std::invalid_argument& error)
    {
      return std::string(error.what()).rfind(key + " is ", 0) == 0;
    }
  };
  EXPECT_TRUE(refused([](auto& o) { o.every_n = 0; }, "every_n"));
  EXPECT_TRUE(refused([](auto& o) { o.target_speed = -1.0; }, "target_speed"));
  EXPECT_TRUE(refused([](auto& o) { o.drift = 0.0; }, "drift"));
  EXPECT_TRUE(refused([](auto& o) { o.drift_rotation = -1.0; }, "drift_rotation"));
  EXPECT_TRUE(refused([](auto& o) { o.drift_residual = 0.0; }, "drift_residual"));
  EXPECT_TRUE(refused([](auto& o) { o.timeout = 0.0; }, "timeout"));
  EXPECT_TRUE(refused([](auto& o) { o.max_correction = 0.0; }, "max_correction"));
  EXPECT_TRUE(refused([](auto& o) { o.max_correction_rotation = 0.0; }, "max_correction_rotation"));
  EXPECT_TRUE(refused([](auto& o) { o.min_similarity = std::nan(""); }, "min_similarity"));
  EXPECT_TRUE(refused([](auto& o) { o.significance = 1.0; }, "significance"));
  EXPECT_EQ(refinementModeFromName("on_drift"), RefinementMode::ON_DRIFT);
  EXPECT_THROW(refinementModeFromName("sometimes"), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
