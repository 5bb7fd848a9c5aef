#include "gate_light.h"

#include <algorithm>

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;

/// No gate is believed for longer, whatever its message says [ns].
constexpr std::int64_t kLongest = 500000000;

bool valid(const HeardGate& heard, std::int64_t now, const std::optional<ros::Time>& clock)
{
  const BeamGate& gate = heard.message;
  if (gate.valid_until < gate.header.stamp || (clock && *clock > gate.valid_until))
  {
    return false;
  }
  const std::int64_t lasts = std::min((gate.valid_until - gate.header.stamp).toNSec(), kLongest);
  return now - heard.arrival <= lasts;
}
}  // namespace

const char* gateReasonWords(std::uint8_t reason)
{
  switch (reason)
  {
    case BeamGate::NONE:
      return "All is well";
    case BeamGate::NO_EXPOSURE:
      return "No exposure yet";
    case BeamGate::NOT_MEASURED:
      return "No pose";
    case BeamGate::INCONSISTENT:
      return "Views contradict each other";
    case BeamGate::STALE:
      return "Exposures have stopped";
    case BeamGate::BAD_STAMP:
      return "Wrong time stamps";
    case BeamGate::UNCERTAIN:
      return "Pose too uncertain";
    case BeamGate::DISPLACED:
      return "Target out of tolerance";
    case BeamGate::JUMP:
      return "Target has jumped";
    case BeamGate::CONFIRMING:
      return "Good, being confirmed";
    case BeamGate::UNVERIFIED:
      return "Pose not verified";
    case BeamGate::HELD:
      return "Held by an operator";
    default:
      return "Unknown reason";
  }
}

GateView gateView(const std::optional<HeardGate>& heard, std::int64_t now, const std::optional<ros::Time>& clock)
{
  if (!heard)
  {
    return { GateLight::SILENT, "NO CONNECTION", "nothing on beam_gate: is motion_estimation running?" };
  }
  if (!valid(*heard, now, clock))
  {
    return { GateLight::SILENT, "NO CONNECTION", "the last message of beam_gate is not valid any more: hold the beam" };
  }
  if (heard->publishers > 1)
  {
    // Which one's message is the last is chance.
    return { GateLight::SILENT, "NOT ONE GATE",
             std::to_string(heard->publishers) +
                 " nodes send gates on beam_gate: hold the beam, and end all but one of them" };
  }
  const BeamGate& gate = heard->message;
  if (gate.open && gate.reason == BeamGate::NONE)
  {
    return { GateLight::OPEN, "OPEN", gate.text };
  }
  if (gate.reason == BeamGate::HELD)
  {
    return { GateLight::HELD, "BEAM HELD", gate.text };
  }
  return { GateLight::CLOSED, "HOLD", gateReasonWords(gate.reason) + (gate.text.empty() ? "" : ": " + gate.text) };
}
}  // namespace xray_tracking
