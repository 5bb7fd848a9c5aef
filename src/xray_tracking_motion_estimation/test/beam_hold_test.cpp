#include "xray_tracking_motion_estimation/beam_hold.h"

#include <cmath>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

#include "xray_tracking_motion_estimation/beam_gate.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kSecond = 1000 * kMillisecond;

TEST(BeamHoldTest, LastsUntilItIsReleased)
{
  BeamHold hold{ BeamHoldOptions() };
  EXPECT_FALSE(hold.held());
  hold.hold("held by an operator");
  for (std::int64_t now = 0; now < 100 * kSecond; now += kSecond)
  {
    hold.tick(now);
    EXPECT_TRUE(hold.held());
    EXPECT_EQ(hold.why(), "held by an operator");
  }
  EXPECT_EQ(hold.release(100 * kSecond), "");
  EXPECT_FALSE(hold.held());
}

TEST(BeamHoldTest, GoesOnAfterARestartOfTheProcess)
{
  BeamHold hold{ BeamHoldOptions() };
  hold.takeUp("held by an operator", false, kSecond);
  hold.tick(1000 * kSecond);
  EXPECT_EQ(hold.why(), "held by an operator");
  EXPECT_EQ(hold.release(1000 * kSecond), "");
  // A panel that was there before has to come again.
  hold.takeUp("", true, 1000 * kSecond);
  EXPECT_FALSE(hold.held());
  hold.tick(1002 * kSecond);
  EXPECT_TRUE(hold.held());
}

TEST(BeamHoldTest, NobodyIsMissedWhoWasNeverThere)
{
  BeamHold hold{ BeamHoldOptions() };
  hold.tick(0);
  hold.tick(1000 * kSecond);
  EXPECT_FALSE(hold.held());
}

TEST(BeamHoldTest, HoldsWhenThePanelIsLostAndNotBefore)
{
  BeamHold hold{ BeamHoldOptions() };
  const std::int64_t heard = 50 * kSecond;
  hold.operatorPresent(heard);
  hold.tick(heard + kSecond);
  EXPECT_FALSE(hold.held());
  hold.tick(heard + kSecond + kMillisecond);
  EXPECT_TRUE(hold.held());
  EXPECT_NE(hold.why().find("silent for 1 s"), std::string::npos) << hold.why();
}

TEST(BeamHoldTest, AReturningPanelReleasesNothingByItself)
{
  BeamHold hold{ BeamHoldOptions() };
  hold.operatorPresent(0);
  hold.tick(2 * kSecond);
  hold.operatorPresent(3 * kSecond);
  EXPECT_TRUE(hold.held());
  EXPECT_EQ(hold.release(3 * kSecond), "");
  EXPECT_FALSE(hold.held());
}

TEST(BeamHoldTest, ASilenceIsSeenByTheHeartbeatThatEndsIt)
{
  BeamHold hold{ BeamHoldOptions() };
  hold.operatorPresent(0);
  hold.operatorPresent(2 * kSecond);  // nobody ticked in between
  EXPECT_TRUE(hold.held());
}

TEST(BeamHoldTest, IsNotReleasedWhileThePanelIsSilent)
{
  BeamHold hold{ BeamHoldOptions() };
  hold.operatorPresent(0);
  hold.tick(2 * kSecond);
  EXPECT_NE(hold.release(3 * kSecond).find("silent"), std::string::npos);
  EXPECT_TRUE(hold.held());
}

TEST(BeamHoldTest, RefusesBadOptions)
{
  for (const double silence : { 0.0, -1.0, std::numeric_limits<double>::infinity(), std::nan("") })
  {
    BeamHoldOptions options;
    options.operator_silence = silence;
    EXPECT_THROW(BeamHold{ options }, std::invalid_argument) << silence;
  }
}

/// Exposures of a target at rest, each good.
class HeldGateTest : public testing::Test
{
protected:
  HeldGateTest() : gate(options()) {}

  static BeamGateOptions options()
  {
    BeamGateOptions options;
    options.verification.initial_pose_verified = true;
    return options;
  }

  void expose()
  {
    now += 33 * kMillisecond;
    GateExposure exposure;
    exposure.stamp = now;
    exposure.arrival = now;
    exposure.fault = GateReason::NONE;
    exposure.covariance = 0.01 * Eigen::Matrix3d::Identity();
    gate.update(exposure);
  }

  void openIt()
  {
    for (int i = 0; i < 5; ++i)
    {
      expose();
    }
    ASSERT_TRUE(gate.open());
  }

  BeamGate gate;
  std::int64_t now = 0;
};

TEST_F(HeldGateTest, IsClosedAtOnceWhateverItJudges)
{
  openIt();
  gate.hold().hold("held by an operator");
  EXPECT_FALSE(gate.open());
  EXPECT_EQ(gate.reason(), GateReason::HELD);
  EXPECT_EQ(gate.text().find("held by an operator; otherwise: 5 good exposures"), 0u) << gate.text();
  for (int i = 0; i < 100; ++i)
  {
    expose();
    gate.tick(now);
    EXPECT_FALSE(gate.open());
    EXPECT_EQ(gate.reason(), GateReason::HELD);
  }
}

TEST_F(HeldGateTest, OpensWithTheReleaseOnlyIfAllIsGood)
{
  openIt();
  gate.hold().hold("held by an operator");
  expose();
  EXPECT_EQ(gate.hold().release(now), "");
  EXPECT_TRUE(gate.open());

  gate.hold().hold("held by an operator");
  now += 10 * kSecond;
  EXPECT_FALSE(gate.tick(now));  // what it says stays the same
  EXPECT_NE(gate.text().find("otherwise: the latest exposure is"), std::string::npos) << gate.text();
  gate.hold().release(now);
  EXPECT_EQ(gate.reason(), GateReason::STALE);
  EXPECT_FALSE(gate.open());
}

TEST_F(HeldGateTest, IsNotReleasedByANewStart)
{
  openIt();
  gate.hold().hold("held by an operator");
  gate.reset("exposures start again");
  gate.refined(now, Eigen::Vector3d::Zero(), 0.0);
  EXPECT_EQ(gate.reason(), GateReason::HELD);
  for (int i = 0; i < 10; ++i)
  {
    expose();
    EXPECT_EQ(gate.reason(), GateReason::HELD);
  }
}

TEST_F(HeldGateTest, ClosesWhenThePanelIsLost)
{
  gate.hold().operatorPresent(now);
  openIt();
  while (now <= kSecond)
  {
    gate.tick(now);
    EXPECT_TRUE(gate.open());
    expose();
  }
  EXPECT_TRUE(gate.tick(now));
  EXPECT_EQ(gate.reason(), GateReason::HELD);
}
}  // namespace
}  // namespace xray_tracking
