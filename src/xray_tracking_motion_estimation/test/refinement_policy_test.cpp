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
  RefinementPolicy makePolicy()
  {
    return RefinementPolicy(options, traceTarget(),
                            [this](const RefinementRequest& request)
                            {
                              if (reachable)
                              {
                                requests.push_back(request);
                              }
                              return reachable;
                            });
  }

  TrackedExposure exposureAt(const Vector6d& motion, double disagreement = 0.3)
  {
    now += kInterval;
    const RigidTransform pose = tracePose(motion);
    Vector6d variances;
    variances << Eigen::Vector3d::Constant(tracked_variance), 3e-4, 3e-4, 3e-4;
    return { now + 1000000 * kMillisecond, pose, covarianceAtOrigin(pose, variances.asDiagonal()), disagreement };
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

  /// How many of 100 exposures at rest are asked for if every answer comes before the next one.
  std::size_t requestsOf100(RefinementPolicy& policy)
  {
    for (int i = 0; i < 100; ++i)
    {
      policy.onExposure(exposureAt(moved(0.0)), now);
      if (policy.pending())
      {
        policy.onReply(answer(moved(0.0)));
      }
    }
    return requests.size();
  }

  /// Asks, spoils the answer, and expects a refusal that names `what`.
  /// @param contradicts it is the tracks that a believed pose contradicts
  void expectRefused(const std::string& what, const std::function<void(RefinementReply&)>& spoil,
                     bool contradicts = false)
  {
    options.mode = RefinementMode::EVERY_FRAME;
    RefinementPolicy policy = makePolicy();
    policy.onExposure(exposureAt(moved(1.0)), now);
    RefinementReply reply = answer(moved(1.1));
    spoil(reply);
    EXPECT_FALSE(policy.onReply(reply));
    EXPECT_NE(policy.lastRefusal().find(what), std::string::npos) << policy.lastRefusal();
    EXPECT_EQ(policy.refused(), 1u);
    EXPECT_EQ(policy.lastRefusalContradicts(), contradicts);
    // The same answer unspoilt is good.
    policy.onExposure(exposureAt(moved(1.0)), now);
    EXPECT_TRUE(policy.onReply(answer(moved(1.1)))) << policy.lastRefusal();
  }

  RefinementPolicyOptions options;
  double tracked_variance = 1.04;  ///< 1 mm of tissue and 0.2 mm of the tracks [mm^2]
  std::vector<RefinementRequest> requests;
  bool reachable = true;
  std::int64_t now = 0;
};

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

TEST_F(RefinementTest, ADemandWaitsForARegistrationThatCanBeReached)
{
  options.mode = RefinementMode::ON_DEMAND;
  RefinementPolicy policy = makePolicy();
  reachable = false;
  policy.demand();
  policy.onExposure(exposureAt(moved(0.0)), now);
  EXPECT_FALSE(policy.pending());
  EXPECT_EQ(policy.unheard(), 1u);
  reachable = true;
  policy.onExposure(exposureAt(moved(0.0)), now);
  EXPECT_TRUE(policy.pending());
}

TEST_F(RefinementTest, AsksOnDrift)
{
  options.mode = RefinementMode::ON_DRIFT;
  RefinementPolicy policy = makePolicy();
  policy.onExposure(exposureAt(moved(0.0)), now);
  policy.onExposure(exposureAt(moved(2.9)), now);
  EXPECT_TRUE(requests.empty());
  policy.onExposure(exposureAt(moved(3.1)), now);
  ASSERT_EQ(requests.size(), 1u);
  EXPECT_TRUE(requests[0].room_from_patient.isApprox(tracePose(moved(3.1))));
  ASSERT_TRUE(policy.onReply(answer(moved(3.0))));

  // Counted from there, by motion, rotation and residual.
  policy.onExposure(exposureAt(moved(5.9, 0.0, 0.0, 0.019)), now);
  EXPECT_EQ(requests.size(), 1u);
  policy.onExposure(exposureAt(moved(5.9, 0.0, 0.0, 0.021)), now);
  EXPECT_EQ(requests.size(), 2u);
  ASSERT_TRUE(policy.onReply(answer(moved(5.9))));
  policy.onExposure(exposureAt(moved(5.9), 1.6), now);
  EXPECT_EQ(requests.size(), 3u);
}

TEST_F(RefinementTest, DriftDoesNotAskAgainAtOnceAfterARefusal)
{
  options.mode = RefinementMode::ON_DRIFT;
  RefinementPolicy policy = makePolicy();
  policy.onExposure(exposureAt(moved(0.0)), now);
  for (int i = 0; i < 300; ++i)  // 10 s
  {
    policy.onExposure(exposureAt(moved(4.0)), now);
    if (policy.pending())
    {
      RefinementReply failure = answer(moved(4.0));
      failure.success = false;
      EXPECT_FALSE(policy.onReply(failure));
    }
  }
  EXPECT_EQ(requests.size(), 5u);  // every 2 s
}

TEST_F(RefinementTest, HasOneRequestUnderWayAndGivesUp)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  for (int i = 0; i < 60; ++i)  // 1.98 s
  {
    policy.onExposure(exposureAt(moved(0.0)), now);
  }
  EXPECT_EQ(requests.size(), 1u);
  const RefinementReply late = answer(moved(0.1));
  EXPECT_FALSE(policy.tick(now));
  EXPECT_TRUE(policy.tick(now + 100 * kMillisecond));
  EXPECT_EQ(policy.timeouts(), 1u);
  EXPECT_FALSE(policy.onReply(late));
  policy.onExposure(exposureAt(moved(0.0)), now);
  EXPECT_FALSE(policy.onReply(late));  // nor does it answer the next request
  EXPECT_TRUE(policy.pending());
  EXPECT_TRUE(policy.onReply(answer(moved(0.1))));
}

TEST_F(RefinementTest, ARequestFromBeforeAResetIsVoid)
{
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  policy.onExposure(exposureAt(moved(0.0)), now);
  policy.reset();
  EXPECT_FALSE(policy.onReply(answer(moved(0.1))));
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
      "correction", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(6.1)); }, true);
  expectRefused(
      "correction", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(1.0, 0.0, 0.0, 0.08)); },
      true);
}

TEST_F(RefinementTest, RefusesWhatIsNoBetterMatch)
{
  expectRefused("similarity", [](RefinementReply& reply) { reply.similarity = 0.79; });
  options.min_similarity = 0.85;
  expectRefused("similarity", [](RefinementReply& reply) { reply.similarity = 0.84; });
}

TEST_F(RefinementTest, AsksForAllInOrderAsFarAsTheQueueReaches)
{
  options.mode = RefinementMode::EVERY_FRAME;
  options.queue_size = 3;
  RefinementPolicy policy = makePolicy();
  std::vector<std::int64_t> stamps;
  for (int i = 0; i < 6; ++i)
  {
    const TrackedExposure exposure = exposureAt(moved(0.1 * i));
    stamps.push_back(exposure.stamp);
    policy.onExposure(exposure, now);
  }
  EXPECT_EQ(policy.skipped(), 2u);
  for (const std::size_t expected : { 0u, 3u, 4u, 5u })
  {
    ASSERT_TRUE(policy.pending());
    EXPECT_EQ(requests.back().stamp, stamps[expected]);
    policy.onReply(answer(moved(0.1 * static_cast<double>(expected))));
    policy.next(now);
  }
  EXPECT_FALSE(policy.pending());
}

TEST_F(RefinementTest, WhatWaitsStartsFromWhereTheRefinementPutsIt)
{
  options.mode = RefinementMode::EVERY_FRAME;
  options.queue_size = 2;
  RefinementPolicy policy = makePolicy();
  policy.onExposure(exposureAt(moved(1.0)), now);
  policy.onExposure(exposureAt(moved(2.0)), now);
  ASSERT_TRUE(policy.onReply(answer(moved(1.3, 0.2))));
  policy.next(now);
  ASSERT_EQ(requests.size(), 2u);
  EXPECT_TRUE(requests[1].room_from_patient.isApprox(tracePose(moved(2.3, 0.2)), 1e-12));
}

// Where the tracks say nothing there is nothing to contradict; what the registration says of itself has to do.
TEST_F(RefinementTest, AnExposureWithoutAPoseIsRefinedFromTheLastOne)
{
  options.mode = RefinementMode::ON_DRIFT;
  RefinementPolicy policy = makePolicy();
  TrackedExposure exposure = exposureAt(moved(0.5));
  exposure.measured = false;
  policy.onExposure(exposure, now);
  ASSERT_EQ(requests.size(), 1u);
  EXPECT_TRUE(requests[0].room_from_patient.isApprox(tracePose(moved(0.5)), 1e-12));
  const auto refinement = policy.onReply(answer(moved(9.0)));
  ASSERT_TRUE(refinement) << policy.lastRefusal();
  EXPECT_FALSE(refinement->tracked);
  EXPECT_TRUE(refinement->refined.isApprox(tracePose(moved(9.0)), 1e-12));

  exposure = exposureAt(moved(9.0));
  exposure.measured = false;
  policy.onExposure(exposure, now);
  RefinementReply reply = answer(moved(9.1));
  reply.success = false;
  reply.text = "flat optimum";
  EXPECT_FALSE(policy.onReply(reply));
  EXPECT_EQ(policy.lastRefusal(), "flat optimum");
  EXPECT_FALSE(policy.lastRefusalContradicts());
}

// Combined deviations: 0.22 mm and 0.0176 rad. chi-square of 6 degrees of freedom is 22.46 at 0.001, so that a single
// axis may be off by 4.74 of them: 1.06 mm, 0.083 rad.
TEST_F(RefinementTest, RefusesWhatContradictsTheTracks)
{
  // With 1 mm of tissue 4.74 * sqrt(0.05 + 1) = 4.86 mm.
  expectRefused(
      "contradicts", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(5.9)); }, true);
  {
    RefinementPolicy policy = makePolicy();
    policy.onExposure(exposureAt(moved(1.0)), now);
    EXPECT_TRUE(policy.onReply(answer(moved(5.8)))) << policy.lastRefusal();
  }
  tracked_variance = 0.04;
  expectRefused(
      "contradicts", [](RefinementReply& reply) { reply.room_from_patient = tracePose(moved(2.08)); }, true);
  options.mode = RefinementMode::EVERY_FRAME;
  RefinementPolicy policy = makePolicy();
  policy.onExposure(exposureAt(moved(1.0)), now);
  EXPECT_TRUE(policy.onReply(answer(moved(2.04)))) << policy.lastRefusal();
  // The covariance is the target's, however long the arm to the origin: two degrees are within the bounds.
  policy.onExposure(exposureAt(moved(1.0)), now);
  EXPECT_TRUE(policy.onReply(answer(moved(1.0, 0.0, 0.0, 0.035)))) << policy.lastRefusal();
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
  history.add(1, tracePose(moved(0.0)));
  history.add(2, tracePose(moved(4.0)));
  const Refinement refinement{ 2, tracePose(moved(4.0)), tracePose(moved(4.5, 0.2, 0.0, 0.02)),
                               PoseCovariance::Zero() };
  history.transform([&](const RigidTransform& pose) { return refinement.carry(pose, traceTarget()); });
  EXPECT_TRUE(history.at(2)->isApprox(refinement.refined, 1e-12));
  EXPECT_TRUE(history.at(1)->isApprox(tracePose(moved(0.5, 0.2, 0.0, 0.02)), 1e-12));
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
  EXPECT_TRUE(refused([](auto& o) { o.queue_size = 0; }, "queue_size"));
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
