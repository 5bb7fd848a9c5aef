#pragma once

#include <vector>

#include "descender.h"

namespace xray_tracking
{
/// How the views at a pose compare with the same rendering elsewhere.
struct Distinctness
{
  double here = 0.0;   ///< mean correlation of the views at the pose, -1 to 1
  double rival = 0.0;  ///< the largest one elsewhere, more than 5 mm away
  double z = 0.0;      ///< of `here`, in standard deviations of what there is elsewhere above their mean
};

/// Slides every view's model over its image, by up to 25 mm at the target, and puts the views' correlations together
/// where their shifts meet in space. What is right by chance is not much better than the best of many other places, and
/// no better the more of noise, tissue and other bodies there is to be like. All zero if a view cannot be slid.
/// @param fine the views at the pose, as they were compared
Distinctness distinctnessOf(const Run& run, const Bodies& bodies, const std::vector<ViewLevel>& fine,
                            const PosePair& poses);
}  // namespace xray_tracking
