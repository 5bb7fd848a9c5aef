#include "xray_tracking_motion_estimation/beam_gate_ros.h"

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

constexpr double kWatchdogPeriod = 0.02;  // s

/// Of what stamps of others may lead to: what ros::Duration does not hold would throw.
ros::Duration durationFromNanoseconds(std::int64_t nanoseconds)
{
  constexpr std::int64_t kLimit = 1000000000000000000;  // 31 years
  return ros::Duration().fromNSec(std::clamp(nanoseconds, -kLimit, kLimit));
}
}  // namespace

std::int64_t steadyNanoseconds()
{
  return static_cast<std::int64_t>(ros::SteadyTime::now().toNSec());
}

BeamGateRos::BeamGateRos(ros::NodeHandle nh, const BeamGateOptions& options) : gate_(options)
{
  publisher_ = nh.advertise<Message>("beam_gate", 100);
  watchdog_ = nh.createSteadyTimer(ros::WallDuration(kWatchdogPeriod), &BeamGateRos::watchdogCb, this);
}

void BeamGateRos::update(const GateExposure& exposure)
{
  if (exposure.fault != GateReason::BAD_STAMP)
  {
    exposure_ = timeFromNanoseconds(exposure.stamp);
  }
  logAndPublish(gate_.update(exposure));
}

void BeamGateRos::watchdogCb(const ros::SteadyTimerEvent&)
{
  logAndPublish(gate_.tick(steadyNanoseconds()));
}

void BeamGateRos::logAndPublish(bool changed)
{
  if (changed && gate_.open())
  {
    ROS_INFO_STREAM("beam gate: open, " << gate_.text());
  }
  else if (changed)
  {
    ROS_WARN_STREAM("beam gate: " << gateReasonName(gate_.reason()) << ", " << gate_.text());
  }
  Message message;
  message.header.stamp = ros::Time::now();
  message.header.frame_id = kRoomFrame;
  message.open = gate_.open();
  message.verified = gate_.verification().verified();
  message.reason = static_cast<std::uint8_t>(gate_.reason());
  message.text = gate_.text();
  if (const auto age = gate_.age(steadyNanoseconds()))
  {
    message.exposure = exposure_;
    message.age = durationFromNanoseconds(*age);
  }
  message.max_age = durationFromNanoseconds(gate_.maxAge());
  message.displacement = vectorMsgFromMillimetres(gate_.displacement());
  message.rotation = gate_.rotation();
  publisher_.publish(message);
}
}  // namespace xray_tracking
