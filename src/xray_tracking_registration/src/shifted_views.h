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

/// How distinct a pose is, by shifts of up to 25 mm. What is right by chance is not much better than the best of many
/// other places, and no better the more of noise, tissue and other bodies there is to be like. All zero where next to
/// nothing around the region is seen.
/// @param fine the views at the pose, as they were compared
/// @param room_centre of the target there
Distinctness distinctnessOf(const FineLevel& fine, const Eigen::Vector3d& room_centre);

/// The shift along the room's axes with which the views are most alike [mm].
/// @param views laid out as far around their regions as `reach`, at most which it is along each axis [mm]
Eigen::Vector3d mostAlikeShift(const Bodies& bodies, const std::vector<ViewLevel>& views, const PosePair& poses,
                               double reach);
}  // namespace xray_tracking
