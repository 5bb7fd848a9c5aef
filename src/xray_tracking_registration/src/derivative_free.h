#pragma once

#include <vector>

#include "image_level.h"
#include "run_control.h"
#include "xray_tracking_registration/similarity.h"

namespace xray_tracking
{
/// Maximises the mean similarity of all views by BOBYQA (Powell 2009; NLopt) from `poses`, which holds the best poses
/// afterwards.
/// @param reach first step of the search, and a fifth of its bounds [mm and degrees]
void optimiseDerivativeFree(const std::vector<ViewLevel>& views, const Bodies& bodies, Moving moving,
                            const Similarity& similarity, double reach, RunControl& control, PosePair& poses);
}  // namespace xray_tracking
