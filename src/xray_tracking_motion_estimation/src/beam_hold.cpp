#include "xray_tracking_motion_estimation/beam_hold.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
void BeamHoldOptions::validate() const
{
  requireOption(operator_silence > 0.0 && std::isfinite(operator_silence), "operator_silence", operator_silence,
                "a number > 0 s");
}

BeamHold::BeamHold(const BeamHoldOptions& options) : options_(options)
{
  options_.validate();
}

void BeamHold::hold(const std::string& why)
{
  why_ = why;
}

std::string BeamHold::release(std::int64_t now)
{
  if (silent(now))
  {
    return "the operator's panel is still silent: start it again, then release";
  }
  why_.clear();
  return std::string();
}

void BeamHold::operatorPresent(std::int64_t now)
{
  tick(now);  // what was missed until now is not forgotten
  heard_ = now;
}

void BeamHold::takeUp(const std::string& why, bool heard, std::int64_t now)
{
  why_ = why;
  heard_ = heard ? std::make_optional(now) : std::nullopt;
}

void BeamHold::tick(std::int64_t now)
{
  if (!held() && silent(now))
  {
    std::ostringstream why;
    why << "the operator's panel was silent for " << options_.operator_silence << " s";
    why_ = why.str();
  }
}

bool BeamHold::silent(std::int64_t now) const
{
  return heard_ && 1e-9 * static_cast<double>(now - *heard_) > options_.operator_silence;
}
}  // namespace xray_tracking
