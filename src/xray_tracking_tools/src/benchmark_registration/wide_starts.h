#pragma once

#include <vector>

#include "trial.h"

namespace xray_tracking
{
/// Wide searches from starts that are off by up to 25 mm and 10 degrees along and about every axis of the room, evenly
/// spread. The trials are added to `trials`.
FigureTable measureWideStarts(const Subject& subject, const Registration& registration, int count,
                              std::vector<Trial>& trials);
}  // namespace xray_tracking
