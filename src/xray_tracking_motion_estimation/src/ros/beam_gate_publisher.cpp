#include "xray_tracking_motion_estimation/beam_gate_publisher.h"

#include <algorithm>

#include <xray_tracking_msgs/BeamGate.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using Message = xray_tracking_msgs::BeamGate;

static_assert(static_cast<int>(GateReason::NONE) == Message::NONE);
static_assert(static_cast<int>(GateReason::NO_EXPOSURE) == Message::NO_EXPOSURE);
static_assert(static_cast<int>(GateReason::NOT_MEASURED) == Message::NOT_MEASURED);
static_assert(static_cast<int>(GateReason::INCONSISTENT) == Message::INCONSISTENT);
static_assert(static_cast<int>(GateReason::STALE) == Message::STALE);
static_assert(static_cast<int>(GateReason::BAD_STAMP) == Message::BAD_STAMP);
static_assert(static_cast<int>(GateReason::UNCERTAIN) == Message::UNCERTAIN);
static_assert(static_cast<int>(GateReason::DISPLACED) == Message::DISPLACED);
static_assert(static_cast<int>(GateReason::JUMP) == Message::JUMP);
static_assert(static_cast<int>(GateReason::CONFIRMING) == Message::CONFIRMING);
static_assert(static_cast<int>(GateReason::UNVERIFIED) == Message::UNVERIFIED);
static_assert(static_cast<int>(GateReason::HELD) == Message::HELD);

/// Two messages may be late before the last one is void [s].
constexpr double kValid = 3.0 * BeamGatePublisher::kPeriod;

/// Of what stamps of others may lead to: what ros::Duration does not hold would throw.
ros::Duration durationFromNanoseconds(std::int64_t nanoseconds)
{
  constexpr std::int64_t kLimit = 1000000000000000000;  // 31 years
  return ros::Duration().fromNSec(std::clamp(nanoseconds, -kLimit, kLimit));
}
}  // namespace

BeamGatePublisher::BeamGatePublisher(ros::NodeHandle nh) : publisher_(nh.advertise<Message>("beam_gate", 1)) {}

void BeamGatePublisher::publish(const BeamGate& gate, const ros::Time& exposure, std::int64_t now)
{
  const bool turned = gate.open() != (logged_ == GateReason::NONE);
  if (gate.reason() != logged_ && (throttle_.due(gateReasonName(gate.reason())) || turned))
  {
    logged_ = gate.reason();
    if (gate.open())
    {
      ROS_INFO_STREAM("beam gate: open, " << gate.text());
    }
    else
    {
      ROS_WARN_STREAM("beam gate: " << gateReasonName(gate.reason()) << ", " << gate.text());
    }
  }
  Message message;
  message.header.stamp = ros::Time::now();
  message.header.frame_id = kRoomFrame;
  message.valid_until =
      timeFromNanoseconds(nanosecondsFromTime(message.header.stamp) + static_cast<std::int64_t>(1e9 * kValid));
  message.open = static_cast<std::uint8_t>(gate.open());
  message.verified = static_cast<std::uint8_t>(gate.verification().verified());
  message.reason = static_cast<std::uint8_t>(gate.reason());
  message.text = gate.text();
  if (const auto age = gate.age(now))
  {
    message.exposure = exposure;
    message.age = durationFromNanoseconds(*age);
  }
  message.max_age = durationFromNanoseconds(gate.maxAge());
  message.displacement = vectorMsgFromMillimetres(gate.displacement());
  message.rotation = gate.rotation();
  publisher_.publish(message);
}
}  // namespace xray_tracking
