#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <xray_tracking_msgs/BeamGate.h>

namespace xray_tracking
{
/// What a person is shown of the beam gate.
enum class GateLight
{
  OPEN,    ///< the beam need not be held
  CLOSED,  ///< it is to be held, by what is judged
  HELD,    ///< it is held by people
  SILENT   ///< nothing valid is known, which is to be taken for closed
};

struct GateView
{
  GateLight light = GateLight::SILENT;
  std::string headline;  ///< two or three words
  std::string reason;    ///< in words; never empty
};

/// The last message of a gate, with when it came.
struct HeardGate
{
  xray_tracking_msgs::BeamGate message;
  std::int64_t arrival = 0;    ///< monotonic clock [ns]
  std::size_t publishers = 1;  ///< nodes that have sent gates lately
};

/// A message counts for as long as it says, from when it came: by the monotonic clock, as the one that it is stamped by
/// may stand still. Where that one runs as the real time does, it counts no longer than until `valid_until` either.
/// @param now monotonic clock [ns]; @param clock real time, none where time is simulated
GateView gateView(const std::optional<HeardGate>& heard, std::int64_t now, const std::optional<ros::Time>& clock);

/// In words, as "Target displaced". @param reason of the message
const char* gateReasonWords(std::uint8_t reason);
}  // namespace xray_tracking
