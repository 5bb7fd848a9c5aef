#pragma once

#include <vector>

#include "xray_tracking_core/volume/solid.h"

namespace xray_tracking
{
/// The two bodies of NeckPhantom, patient frame.
struct NeckSolids
{
  std::vector<Solid> target;
  std::vector<Solid> rest;
};

/// Skin to airway, skull and jaw: all that is not spine.
void addNeckSurroundings(std::vector<Solid>& rest);

/// C1 to T2 with their discs.
void addCervicalSpine(NeckSolids& neck);

/// Box around C4's body and arch with its processes, patient frame [mm].
Eigen::AlignedBox3d boxAroundC4();
}  // namespace xray_tracking
