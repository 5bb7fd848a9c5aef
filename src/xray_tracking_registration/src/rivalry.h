#pragma once

#include <vector>

#include "descender.h"

namespace xray_tracking
{
constexpr double kElsewhere = 0.8;  ///< from what was found: another place [mm]

/// A place that was found, as a rival of another one.
Rival rivalFrom(const Outcome& place);

/// Logarithm of the odds that an outcome is the right place and not the rival: by how much more alike the images are
/// there, and by which of both is nearer to the start.
double oddsOver(const Run& run, const Outcome& outcome, const Rival& rival);

/// Places the rivals against the answer: their distances, rotations and odds, most similar first. Those that are the
/// answer itself are left out; the answer is doubted if it is not as probable as is asked for against one of them.
/// @param target_box patient frame [mm]
std::vector<Rival> weighRivals(const Run& run, const Eigen::AlignedBox3d& target_box, std::vector<Rival> rivals,
                               double min_probability, Outcome& answer);
}  // namespace xray_tracking
