#include "xray_tracking_motion_estimation/beam_gate.h"

#include <functional>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kInterval = 33 * kMillisecond;
constexpr std::int64_t kDelay = 20 * kMillisecond;

BeamGateOptions statedOptions()
{
  BeamGateOptions options;
  options.verification.initial_pose_verified = true;
  return options;
}

BeamGateOptions registrationOptions()
{
  BeamGateOptions options;
  options.verification.registration = true;
  return options;
}

/// A gate with exposures of a target at rest, 33 ms apart, whose poses come 20 ms later. The monotonic clock has its
/// own zero.
class BeamGateTest : public testing::Test
{
protected:
  GateExposure good(std::int64_t after = kInterval)
  {
    stamp += after;
    GateExposure exposure;
    exposure.stamp = stamp;
    exposure.delay = kDelay;
    exposure.arrival = stamp + kDelay - zero;
    exposure.fault = GateReason::NONE;
    exposure.displacement = { 1.0, 0.0, 0.0 };
    exposure.covariance = 0.01 * Eigen::Matrix3d::Identity();
    return exposure;
  }

  void openIt()
  {
    for (int i = 0; i < options.good_exposures; ++i)
    {
      EXPECT_FALSE(gate.open());
      gate.update(good());
    }
    ASSERT_TRUE(gate.open());
  }

  /// Opens the gate, spoils the next exposure, expects it to close for `reason` and to open again after good ones.
  void expectClosedBy(GateReason reason, const std::function<void(GateExposure&)>& spoil)
  {
    if (!gate.open())
    {
      openIt();
    }
    GateExposure bad = good();
    spoil(bad);
    EXPECT_TRUE(gate.update(bad));
    EXPECT_FALSE(gate.open());
    EXPECT_EQ(gate.reason(), reason) << gate.text();
    EXPECT_FALSE(gate.text().empty());
    openIt();
  }

  std::int64_t now() const { return stamp + kDelay - zero; }

  BeamGateOptions options = statedOptions();
  BeamGate gate{ options };
  std::int64_t stamp = 1700000000000000000;
  std::int64_t zero = 1699999990000000000;
};

TEST_F(BeamGateTest, IsClosedAtTheStart)
{
  EXPECT_FALSE(gate.open());
  EXPECT_EQ(gate.reason(), GateReason::NO_EXPOSURE);
  EXPECT_FALSE(gate.age(now()));
  EXPECT_FALSE(gate.tick(now()));
  EXPECT_FALSE(gate.open());
}

TEST_F(BeamGateTest, OpensAfterGoodExposuresOnly)
{
  EXPECT_TRUE(gate.update(good()));
  EXPECT_EQ(gate.reason(), GateReason::CONFIRMING);
  for (int i = 2; i < options.good_exposures; ++i)
  {
    EXPECT_FALSE(gate.update(good()));
  }
  EXPECT_FALSE(gate.open());
  EXPECT_TRUE(gate.update(good()));
  EXPECT_TRUE(gate.open());
  EXPECT_EQ(gate.displacement(), Eigen::Vector3d(1.0, 0.0, 0.0));
  EXPECT_EQ(*gate.age(now()), kDelay);
  EXPECT_FALSE(gate.update(good()));  // no transition
}

TEST_F(BeamGateTest, ClosesWithoutAPose)
{
  expectClosedBy(GateReason::NOT_MEASURED, [](GateExposure& e) { e.fault = GateReason::NOT_MEASURED; });
}

TEST_F(BeamGateTest, ClosesIfViewsContradictEachOther)
{
  expectClosedBy(GateReason::INCONSISTENT, [](GateExposure& e) { e.fault = GateReason::INCONSISTENT; });
}

TEST_F(BeamGateTest, ClosesOnUncertainty)
{
  // Within the bound along every axis, over it in between.
  expectClosedBy(GateReason::UNCERTAIN,
                 [](GateExposure& e) { e.covariance << 2.0, 1.5, 0.0, 1.5, 2.0, 0.0, 0.0, 0.0, 0.1; });
  expectClosedBy(GateReason::UNCERTAIN, [](GateExposure& e) { e.covariance(1, 1) = -1.0; });
  expectClosedBy(GateReason::UNCERTAIN, [](GateExposure& e) { e.doubt = "detector_a is degraded"; });
}

/// Between registrations a third of 1.5 mm is the most that tracks may be uncertain by; without any they have to do.
TEST_F(BeamGateTest, ClosesOnUncertaintyBetweenRegistrations)
{
  const auto reason = [this](double sigma, bool registration, bool registered, double max_sigma)
  {
    BeamGateOptions of_case = registration ? registrationOptions() : statedOptions();
    of_case.max_sigma = max_sigma;
    BeamGate judging(of_case);
    for (int i = 0; i < of_case.good_exposures + 1; ++i)
    {
      GateExposure exposure = good();
      exposure.registered = registration && (registered || i < of_case.good_exposures);
      exposure.covariance(2, 2) = i < of_case.good_exposures ? 0.01 : sigma * sigma;
      EXPECT_EQ(i >= of_case.good_exposures, judging.open());
      judging.update(exposure);
    }
    return judging.reason();
  };
  EXPECT_EQ(GateReason::NONE, reason(0.49, true, false, 1.5));
  EXPECT_EQ(GateReason::UNCERTAIN, reason(0.51, true, false, 1.5));
  EXPECT_EQ(GateReason::NONE, reason(1.49, true, true, 1.5));
  EXPECT_EQ(GateReason::UNCERTAIN, reason(1.51, true, true, 1.5));
  EXPECT_EQ(GateReason::NONE, reason(1.49, false, false, 1.5));
  EXPECT_EQ(GateReason::UNCERTAIN, reason(0.41, true, false, 0.4)) << "the smaller of both counts";
}

TEST_F(BeamGateTest, ClosesOnRotation)
{
  expectClosedBy(GateReason::DISPLACED, [](GateExposure& e) { e.rotation = 0.06; });
}

// A rotation that nobody measures counts by its variance, together with what is measured.
TEST_F(BeamGateTest, ClosesOnRotationThatIsNotMeasured)
{
  const auto variance = [&](double share) { return std::pow(share * options.max_rotation, 2); };
  expectClosedBy(GateReason::DISPLACED, [&](GateExposure& exposure) { exposure.rotation_variance = variance(1.01); });
  expectClosedBy(GateReason::DISPLACED,
                 [&](GateExposure& exposure)
                 {
                   exposure.rotation = 0.8 * options.max_rotation;
                   exposure.rotation_variance = variance(0.61);
                 });
  GateExposure exposure = good();
  exposure.rotation = 0.8 * options.max_rotation;
  exposure.rotation_variance = variance(0.59);
  EXPECT_FALSE(gate.update(exposure)) << gate.text();
}

TEST_F(BeamGateTest, ClosesOnNumbersThatAreNone)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  expectClosedBy(GateReason::NOT_MEASURED, [&](GateExposure& e) { e.displacement.y() = nan; });
  expectClosedBy(GateReason::NOT_MEASURED, [&](GateExposure& e) { e.covariance(0, 2) = nan; });
  expectClosedBy(GateReason::NOT_MEASURED, [&](GateExposure& e) { e.rotation = nan; });
  EXPECT_TRUE(gate.displacement().allFinite());
}

TEST_F(BeamGateTest, ClosesOnDisplacement)
{
  openIt();
  // 40 mm/s, as fast as breathing may be.
  for (int i = 0; i < 30 && gate.open(); ++i)
  {
    GateExposure exposure = good();
    exposure.displacement.x() = 1.0 + 1.32 * (i + 1);
    gate.update(exposure);
    EXPECT_EQ(gate.open(), exposure.displacement.norm() <= options.max_displacement);
  }
  EXPECT_EQ(gate.reason(), GateReason::DISPLACED);
  EXPECT_EQ(gate.text(),
            "the target is displaced by 3.64 mm and turned by 0.0 degrees, known to 0.0 degrees, "
            "expected at most 3.00 mm and 3.0 degrees");
}

TEST_F(BeamGateTest, ClosesOnLateExposures)
{
  expectClosedBy(GateReason::STALE,
                 [](GateExposure& e)
                 {
                   e.delay = 3 * kInterval + kMillisecond;
                   e.arrival = e.arrival - kDelay + e.delay;
                 });
}

TEST_F(BeamGateTest, ClosesOnAnExposureOfTheFutureAndCountsNothingFromIt)
{
  openIt();
  GateExposure future = good();
  const std::int64_t latest = stamp - kInterval;
  future.stamp += 1000 * kInterval;
  future.fault = GateReason::BAD_STAMP;
  future.displacement.x() = 20.0;  // no jump, as nobody knows when
  EXPECT_TRUE(gate.update(future));
  EXPECT_EQ(gate.reason(), GateReason::BAD_STAMP);
  EXPECT_FALSE(gate.text().empty());
  EXPECT_EQ(*gate.age(latest - zero), 0);
  EXPECT_EQ(gate.displacement().x(), 1.0);
  openIt();
}

TEST_F(BeamGateTest, ClosesOnStampsThatDoNotGrow)
{
  openIt();
  GateExposure same = good(0);
  EXPECT_TRUE(gate.update(same));
  EXPECT_EQ(gate.reason(), GateReason::BAD_STAMP);
  openIt();
  EXPECT_TRUE(gate.update(good(-kInterval)));
  EXPECT_EQ(gate.reason(), GateReason::BAD_STAMP);
}

TEST_F(BeamGateTest, ClosesInSilence)
{
  openIt();
  const std::int64_t exposed = stamp - zero;
  EXPECT_EQ(gate.maxAge(), 3 * kInterval);
  EXPECT_FALSE(gate.tick(exposed + 3 * kInterval));
  EXPECT_TRUE(gate.open());
  EXPECT_TRUE(gate.tick(exposed + 3 * kInterval + 1));
  EXPECT_EQ(gate.reason(), GateReason::STALE);
  EXPECT_FALSE(gate.tick(exposed + 100 * kInterval));  // no further transition
  stamp += 100 * kInterval;
  openIt();
}

TEST_F(BeamGateTest, AGapWithoutATickStartsCountingAgain)
{
  openIt();
  gate.update(good(4 * kInterval));
  EXPECT_EQ(gate.reason(), GateReason::CONFIRMING);
  for (int i = 1; i < options.good_exposures; ++i)
  {
    EXPECT_FALSE(gate.open());
    gate.update(good());
  }
  EXPECT_TRUE(gate.open());
}

// Every third exposure is missing, stamps jitter: the interval is still that of the source.
TEST_F(BeamGateTest, KnowsTheIntervalInSpiteOfDrops)
{
  for (int i = 0; i < 200; ++i)
  {
    gate.update(good(i % 3 == 0 ? 2 * kInterval : kInterval + (i % 5 - 2) * kMillisecond / 2));
  }
  EXPECT_NEAR(static_cast<double>(gate.maxAge()), 3.0 * kInterval, 3.0 * kMillisecond);
  EXPECT_TRUE(gate.open());
}

TEST_F(BeamGateTest, ASlowSourceDoesNotMakeOldExposuresYoung)
{
  for (int i = 0; i < 100; ++i)
  {
    gate.update(good(2000 * kMillisecond));
    EXPECT_FALSE(gate.open());
  }
  EXPECT_EQ(gate.maxAge(), static_cast<std::int64_t>(3 * 1e9 * options.max_interval));
}

class JumpTest : public BeamGateTest
{
protected:
  void SetUp() override
  {
    openIt();
    GateExposure exposure = good();
    exposure.displacement.x() = -1.5;  // 2.5 mm in 33 ms: 76 mm/s
    EXPECT_TRUE(gate.update(exposure));
    EXPECT_EQ(gate.reason(), GateReason::JUMP);
  }

  GateExposure there()
  {
    GateExposure exposure = good();
    exposure.displacement.x() = -1.5;
    return exposure;
  }
};

TEST_F(JumpTest, IsBelievedAfterManyConsistentExposures)
{
  for (int i = 1; i <= options.jump_exposures; ++i)
  {
    gate.update(there());
    EXPECT_EQ(gate.open(), i == options.jump_exposures) << i;
  }
}

TEST_F(JumpTest, AndBackIsAnother)
{
  for (int i = 0; i < 10; ++i)
  {
    gate.update(there());
  }
  gate.update(good());
  for (int i = 1; i < options.jump_exposures; ++i)
  {
    gate.update(good());
    EXPECT_FALSE(gate.open());
  }
  gate.update(good());
  EXPECT_TRUE(gate.open());
}

TEST_F(JumpTest, IsConfirmedByARefinement)
{
  const std::int64_t jump = stamp;
  gate.update(there());
  // The answer about an exposure from before it says nothing of it.
  EXPECT_FALSE(gate.refined(jump - kInterval, Eigen::Vector3d::Zero(), 0.0));
  for (int i = 1; i <= options.good_exposures; ++i)
  {
    gate.update(there());
    EXPECT_EQ(gate.reason(), GateReason::JUMP);
  }
  EXPECT_FALSE(gate.refined(jump, Eigen::Vector3d(0.2, 0.0, 0.0), 0.0));
  EXPECT_FALSE(gate.open());
  for (int i = 1; i <= options.good_exposures; ++i)
  {
    EXPECT_FALSE(gate.open());
    gate.update(there());
  }
  EXPECT_TRUE(gate.open());
}

TEST_F(JumpTest, OutlastsSilence)
{
  gate.tick(now() + 1000 * kMillisecond);
  EXPECT_EQ(gate.reason(), GateReason::STALE);
  stamp += 1000 * kMillisecond;
  for (int i = 1; i < options.jump_exposures; ++i)
  {
    gate.update(there());
    EXPECT_FALSE(gate.open());
  }
}

TEST_F(BeamGateTest, ATargetFoundElsewhereAfterALossIsAJump)
{
  openIt();
  for (int i = 0; i < 100; ++i)
  {
    GateExposure lost = good();
    lost.fault = GateReason::NOT_MEASURED;
    gate.update(lost);
  }
  GateExposure elsewhere = good();
  elsewhere.displacement.x() = 20.0;  // 6 mm/s, but nobody watched
  gate.update(elsewhere);
  EXPECT_EQ(gate.reason(), GateReason::JUMP);
}

// Age does not hide it: exposures that follow are where it led.
TEST_F(BeamGateTest, AJumpInAnOldExposureIsOne)
{
  openIt();
  const auto there = [&]
  {
    GateExposure exposure = good();
    exposure.displacement.x() = -1.5;
    return exposure;
  };
  GateExposure refused = there();
  refused.delay = 4 * kInterval;
  gate.update(refused);
  EXPECT_EQ(gate.reason(), GateReason::STALE);
  for (int i = 1; i <= options.jump_exposures; ++i)
  {
    gate.update(there());
    EXPECT_EQ(gate.open(), i == options.jump_exposures) << i;
  }
}

TEST_F(BeamGateTest, ARefinementMovesTheTargetWithoutAJump)
{
  openIt();
  const Eigen::Vector3d correction(1.0, -2.0, 0.0);
  EXPECT_FALSE(gate.refined(stamp, correction, 0.01));
  EXPECT_TRUE(gate.open());
  GateExposure exposure = good();
  exposure.displacement += correction - Eigen::Vector3d::UnitX();
  EXPECT_FALSE(gate.update(exposure));
  EXPECT_TRUE(gate.open());
}

TEST_F(BeamGateTest, ARefinementThatPutsTheTargetOutsideClosesAtOnce)
{
  openIt();
  EXPECT_TRUE(gate.refined(stamp, Eigen::Vector3d(1.5, -2.0, 0.0), 0.0));  // from (1, 0, 0): 3.2 mm
  EXPECT_EQ(gate.reason(), GateReason::DISPLACED);
  gate.refined(stamp, Eigen::Vector3d(-1.5, 2.0, 0.0), 0.0);
  openIt();
  EXPECT_TRUE(gate.refined(stamp, Eigen::Vector3d::Zero(), 2.0 * options.max_rotation));
  EXPECT_EQ(gate.reason(), GateReason::DISPLACED);
}

TEST_F(BeamGateTest, WhatIsSaidOfADisplacedTargetIsOfWhereARefinementHasPutIt)
{
  openIt();
  GateExposure exposure = good();
  exposure.displacement = { 5.4, 0.0, 0.0 };
  exposure.registered = true;  // no jump
  gate.update(exposure);
  EXPECT_NE(gate.text().find("displaced by 5.40 mm"), std::string::npos) << gate.text();
  EXPECT_FALSE(gate.refined(stamp, Eigen::Vector3d(3.91, 0.0, 0.0), 0.0));
  EXPECT_EQ(gate.reason(), GateReason::DISPLACED);
  EXPECT_NE(gate.text().find("displaced by 9.31 mm"), std::string::npos) << gate.text();
  // Back within its bounds: nothing says any more that it is not, and the next exposures decide.
  EXPECT_TRUE(gate.refined(stamp, Eigen::Vector3d(-8.31, 0.0, 0.0), 0.0));
  EXPECT_EQ(gate.reason(), GateReason::CONFIRMING) << gate.text();
  openIt();
}

TEST_F(BeamGateTest, StartsAgainWhenTimeDoes)
{
  openIt();
  EXPECT_TRUE(gate.reset("time went back by 100 s"));
  EXPECT_EQ(gate.reason(), GateReason::NO_EXPOSURE);
  EXPECT_EQ(gate.text(), "time went back by 100 s");
  stamp -= 100000 * kMillisecond;
  zero -= 100000 * kMillisecond;
  openIt();
}

// No registration, no statement: tracks alone never open it.
TEST_F(BeamGateTest, StaysClosedWhileNothingVerifiesTheInitialPose)
{
  gate = BeamGate(BeamGateOptions());
  for (int i = 0; i < 200; ++i)
  {
    gate.update(good());
    EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  }
  EXPECT_NE(gate.text().find("initial_pose_verified"), std::string::npos) << gate.text();
}

// What is not verified does not hide what is worse; it does hide a place that is a guess.
TEST_F(BeamGateTest, SaysWhatIsWorseThanUnverified)
{
  gate = BeamGate(BeamGateOptions());
  GateExposure exposure = good();
  exposure.fault = GateReason::INCONSISTENT;
  gate.update(exposure);
  EXPECT_EQ(gate.reason(), GateReason::INCONSISTENT);
  exposure = good();
  exposure.displacement.x() = 42.0;
  gate.update(exposure);
  EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
}

class VerifiedByRegistrationTest : public BeamGateTest
{
protected:
  VerifiedByRegistrationTest()
  {
    options = registrationOptions();
    gate = BeamGate(options);
  }

  void confirm() { gate.refined(stamp, Eigen::Vector3d::Zero(), 0.0); }

  /// Good exposures until `count` have come, the gate closed before each of them; open then.
  void openAfter(int count)
  {
    for (int i = 0; i < count; ++i)
    {
      EXPECT_FALSE(gate.open());
      gate.update(good());
    }
    EXPECT_TRUE(gate.open()) << gate.text();
  }

  /// Verified at the first exposure.
  void openVerified()
  {
    gate.update(good());
    confirm();
    openAfter(options.good_exposures - 1);
  }
};

TEST_F(VerifiedByRegistrationTest, OpensAfterARefinementAndGoodExposures)
{
  for (int i = 0; i < 100; ++i)
  {
    gate.update(good());
    EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
    gate.refused("flat optimum", false);
  }
  EXPECT_NE(gate.text().find("100 refused"), std::string::npos) << gate.text();
  EXPECT_NE(gate.text().find("flat optimum"), std::string::npos) << gate.text();
  EXPECT_FALSE(gate.refined(stamp, Eigen::Vector3d::Zero(), 0.0)) << "after refusals it takes two";
  EXPECT_TRUE(gate.refined(stamp, Eigen::Vector3d::Zero(), 0.0));
  // Told at once, also if no further exposure comes.
  EXPECT_EQ(gate.reason(), GateReason::CONFIRMING);
  // They have been good otherwise all the time.
  openAfter(1);
}

TEST_F(VerifiedByRegistrationTest, ExposuresThatWereBadOtherwiseDoNotCount)
{
  for (int i = 0; i < 10; ++i)
  {
    GateExposure bad = good();
    bad.rotation = 2.0 * options.max_rotation;
    gate.update(bad);
    EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED) << "which place is bad is a guess";
  }
  confirm();
  openAfter(options.good_exposures);
}

TEST_F(VerifiedByRegistrationTest, ARegisteredPoseVerifiesItself)
{
  for (int i = 1; i <= options.good_exposures; ++i)
  {
    GateExposure exposure = good();
    exposure.registered = true;
    gate.update(exposure);
    EXPECT_EQ(gate.reason(), i < options.good_exposures ? GateReason::CONFIRMING : GateReason::NONE) << gate.text();
  }
  // Tracked ones that follow are as good for a while.
  gate.update(good());
  EXPECT_TRUE(gate.open()) << gate.text();
}

TEST_F(VerifiedByRegistrationTest, ARegisteredPoseElsewhereIsNoJump)
{
  openVerified();
  GateExposure exposure = good();
  exposure.registered = true;
  exposure.displacement = { -2.0, 0.0, 0.0 };  // 3 mm in 33 ms
  EXPECT_FALSE(gate.update(exposure)) << gate.text();
  EXPECT_TRUE(gate.open());
  exposure = good();  // and back without a registration
  gate.update(exposure);
  EXPECT_EQ(gate.reason(), GateReason::JUMP);
}

TEST_F(VerifiedByRegistrationTest, ARegisteredPoseOutsideOfTheBoundsCloses)
{
  openVerified();
  GateExposure exposure = good();
  exposure.registered = true;
  exposure.displacement = { 3.1, 0.0, 0.0 };
  EXPECT_TRUE(gate.update(exposure));
  EXPECT_EQ(gate.reason(), GateReason::DISPLACED);
}

TEST_F(VerifiedByRegistrationTest, ClosesOnceNothingHasConfirmedItForLong)
{
  gate.update(good());
  confirm();
  const std::int64_t confirmed = stamp;
  openAfter(options.good_exposures - 1);
  while (stamp - confirmed <= 450 * kMillisecond)
  {
    gate.update(good());
    gate.refused("flat optimum", false);
    EXPECT_TRUE(gate.open()) << gate.text();
  }
  while (stamp - confirmed <= 500 * kMillisecond)
  {
    EXPECT_TRUE(gate.open());
    gate.update(good());
  }
  EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  EXPECT_NE(gate.text().find("flat optimum"), std::string::npos) << gate.text();
  confirm();
  confirm();
  openAfter(options.good_exposures);
}

TEST_F(VerifiedByRegistrationTest, ClosesAtOnceOnAContradiction)
{
  openVerified();
  EXPECT_TRUE(gate.refused("the correction is 7 mm", true));
  EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  EXPECT_NE(gate.text().find("the correction is 7 mm"), std::string::npos) << gate.text();
  for (int i = 0; i < 100; ++i)
  {
    gate.update(good());
    EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  }
  // Each of them counts.
  gate.refused("the correction is 7 mm", true);
  confirm();
  confirm();
  openAfter(options.good_exposures);
}

TEST_F(VerifiedByRegistrationTest, ADoubtClosesAtOnce)
{
  openVerified();
  EXPECT_TRUE(gate.doubt("the templates are of another time"));
  EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  EXPECT_NE(gate.text().find("the templates are of another time"), std::string::npos) << gate.text();
}

TEST_F(VerifiedByRegistrationTest, NothingIsVerifiedWhenTimeStartsAgain)
{
  openVerified();
  gate.reset("time went back");
  for (int i = 0; i < 10; ++i)
  {
    gate.update(good());
    EXPECT_EQ(gate.reason(), GateReason::UNVERIFIED);
  }
}

// 20 s between exposures, for which max_interval has to be set: each is registered, and one of three may be refused.
TEST_F(VerifiedByRegistrationTest, HoldsOverExposuresThatAreFarApart)
{
  options.max_interval = 20.0;
  gate = BeamGate(options);
  for (int i = 0; i < 20; ++i)
  {
    gate.update(good(20000 * kMillisecond));
    EXPECT_EQ(gate.open(), i + 1 >= options.good_exposures) << i << ' ' << gate.text();
    if (i % 3 != 2)
    {
      confirm();
    }
    else
    {
      gate.refused("flat optimum", false);
    }
  }
}

TEST(BeamGateOptions, AreChecked)
{
  const auto refused = [](const std::function<void(BeamGateOptions&)>& spoil, const std::string& key)
  {
    BeamGateOptions options;
    spoil(options);
    try
    {
      BeamGate gate(options);
      return false;
    }
    catch (const std::invalid_argument& error)
    {
      return std::string(error.what()).find(key) != std::string::npos;
    }
  };
  EXPECT_TRUE(refused([](auto& o) { o.max_age = 0.5; }, "max_age"));
  EXPECT_TRUE(refused([](auto& o) { o.max_interval = 0.0; }, "max_interval"));
  EXPECT_TRUE(refused([](auto& o) { o.max_displacement = -1.0; }, "max_displacement"));
  EXPECT_TRUE(refused([](auto& o) { o.max_rotation = 0.0; }, "max_rotation"));
  EXPECT_TRUE(refused([](auto& o) { o.max_sigma = std::numeric_limits<double>::quiet_NaN(); }, "max_sigma"));
  EXPECT_TRUE(refused([](auto& o) { o.max_tracked_sigma = 0.0; }, "max_tracked_sigma"));
  EXPECT_TRUE(refused([](auto& o) { o.max_speed = std::numeric_limits<double>::infinity(); }, "max_speed"));
  EXPECT_TRUE(refused([](auto& o) { o.good_exposures = 1; }, "good_exposures"));
  EXPECT_TRUE(refused([](auto& o) { o.jump_exposures = 2; }, "jump_exposures"));
  EXPECT_TRUE(refused([](auto& o) { o.verification.max_unverified_time = 0.0; }, "max_unverified_time"));
  EXPECT_TRUE(refused([](auto& o) { o.verification.max_unverified_exposures = 0.5; }, "max_unverified_exposures"));
}
}  // namespace
}  // namespace xray_tracking
