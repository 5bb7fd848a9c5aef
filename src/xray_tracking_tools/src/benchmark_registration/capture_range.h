#pragma once

#include <vector>

#include "trial.h"

namespace xray_tracking
{
/// Success by the start's distance, 0 to 16 mm in bands of 2 mm and 0 to 10 degrees, and the capture range. The trials
/// are added to `trials`.
FigureTable measureCaptureRange(const Subject& subject, const Registration& registration, int count,
                                std::vector<Trial>& trials);

/// Errors from starts of 2 mm and 1 degree, 5 and 3, 10 and 5.
FigureTable measureRefinement(const Subject& subject, const Registration& registration, int count,
                              std::vector<Trial>& trials);
}  // namespace xray_tracking
