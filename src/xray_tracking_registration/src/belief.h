#pragma once

#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// How probable it is that the target is off by less than kBelievedError, from the figures of a result
/// (docs/belief.md), 0 to 1. 0 where a figure is not finite.
/// @param near_verified it is near a start that is verified: more probable before anything is seen
double probabilityOf(const BeliefFigures& figures, bool near_verified = false);

/// The figure that speaks most against a result, in words.
std::string mostDoubtful(const BeliefFigures& figures);
}  // namespace xray_tracking
