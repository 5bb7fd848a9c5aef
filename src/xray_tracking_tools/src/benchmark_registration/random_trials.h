#pragma once

#include <string>
#include <vector>

#include "trial.h"

namespace xray_tracking
{
/// Registers random subjects from right and from wrong starts: up to 16 mm and 10 degrees off, farther, at the next
/// vertebra, turned, upside down, with mirrored or exchanged images, one image of another exposure, or the CT of
/// something else. The table says for each kind how many ended right, and what of that was believed.
/// @param scans folder with CTs, see Scans; @param seed of the first subject, the next has the next
/// The trials are added to `trials`.
std::vector<FigureTable> measureRandomSubjects(const std::string& scans, int seed, int subjects,
                                               std::vector<Trial>& trials);
}  // namespace xray_tracking
