#include "gate_light.h"

#include <gtest/gtest.h>

#include "recent_values.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;
constexpr std::int64_t kMillisecond = 1000000;

HeardGate heard(bool open, std::uint8_t reason)
{
  HeardGate gate;
  gate.message.header.stamp = ros::Time(100.0);
  gate.message.valid_until = ros::Time(100.06);
  gate.message.open = static_cast<std::uint8_t>(open);
  gate.message.reason = reason;
  gate.message.text = "why";
  gate.arrival = 5000 * kMillisecond;
  return gate;
}

TEST(GateLightTest, NothingHeardIsNoConnection)
{
  const GateView view = gateView(std::nullopt, 0, std::nullopt);
  EXPECT_EQ(view.light, GateLight::SILENT);
  EXPECT_FALSE(view.reason.empty());
}

TEST(GateLightTest, SaysWhatTheMessageSays)
{
  const std::int64_t now = 5010 * kMillisecond;
  EXPECT_EQ(gateView(heard(true, BeamGate::NONE), now, std::nullopt).light, GateLight::OPEN);
  EXPECT_EQ(gateView(heard(false, BeamGate::HELD), now, std::nullopt).light, GateLight::HELD);
  EXPECT_EQ(gateView(heard(false, BeamGate::DISPLACED), now, std::nullopt).light, GateLight::CLOSED);
  EXPECT_EQ(gateView(heard(false, BeamGate::DISPLACED), now, std::nullopt).reason, "Target out of tolerance: why");
}

TEST(GateLightTest, AMessageThatContradictsItselfIsClosed)
{
  const std::int64_t now = 5010 * kMillisecond;
  EXPECT_EQ(gateView(heard(true, BeamGate::DISPLACED), now, std::nullopt).light, GateLight::CLOSED);
  EXPECT_EQ(gateView(heard(false, BeamGate::NONE), now, std::nullopt).light, GateLight::CLOSED);
  EXPECT_EQ(gateView(heard(true, BeamGate::HELD), now, std::nullopt).light, GateLight::HELD);
  EXPECT_EQ(gateView(heard(false, 200), now, std::nullopt).light, GateLight::CLOSED);
}

TEST(GateLightTest, EndsWithItsValidityByTheMonotonicClock)
{
  const HeardGate open = heard(true, BeamGate::NONE);
  EXPECT_EQ(gateView(open, 5060 * kMillisecond, std::nullopt).light, GateLight::OPEN);
  EXPECT_EQ(gateView(open, 5061 * kMillisecond, std::nullopt).light, GateLight::SILENT);
}

TEST(GateLightTest, AMessageThatTravelledTooLongIsNone)
{
  const HeardGate open = heard(true, BeamGate::NONE);
  EXPECT_EQ(gateView(open, open.arrival, ros::Time(100.05)).light, GateLight::OPEN);
  EXPECT_EQ(gateView(open, open.arrival, ros::Time(100.07)).light, GateLight::SILENT);
}

TEST(GateLightTest, NoMessageLastsLongWhateverItSays)
{
  HeardGate open = heard(true, BeamGate::NONE);
  open.message.valid_until = ros::Time(100000.0);
  EXPECT_EQ(gateView(open, open.arrival + 501 * kMillisecond, std::nullopt).light, GateLight::SILENT);
  open.message.valid_until = ros::Time(99.0);
  EXPECT_EQ(gateView(open, open.arrival, std::nullopt).light, GateLight::SILENT);
}

TEST(GateLightTest, OfSeveralGatesNoneIsBelieved)
{
  HeardGate open = heard(true, BeamGate::NONE);
  open.publishers = 2;
  const GateView view = gateView(open, open.arrival, std::nullopt);
  EXPECT_EQ(view.light, GateLight::SILENT);
  EXPECT_NE(view.reason.find("2 nodes send gates"), std::string::npos) << view.reason;
}

TEST(RecentValuesTest, KeepsTheSpanAndWhatWasSoWhenItBegan)
{
  RecentValues<int> values(100, 1000);
  for (int i = 0; i < 50; ++i)
  {
    values.add(10 * i, i);
  }
  ASSERT_EQ(values.entries().size(), 12U);  // 390 to 490 and the one before
  EXPECT_EQ(values.entries().front().time, 380);
  RecentValues<int> few(1000000, 5);
  for (int i = 0; i < 50; ++i)
  {
    few.add(i, i);
  }
  EXPECT_EQ(few.entries().size(), 5U);
  EXPECT_EQ(few.entries().back().value, 49);
}
}  // namespace
}  // namespace xray_tracking
