#pragma once

#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace xray_tracking
{
/// What a ray crosses, in two parts that may have poses of their own: the target's bone with what is next to it, and
/// the rest of the body. Attenuation [1/mm] and so line integrals add: where both have one pose, they make the CT.
struct BodyModel
{
  ScalarVolume target;
  ScalarVolume rest;  ///< empty (no voxels) if there is one body alone

  /// Bytes of both.
  std::size_t memory() const { return sizeof(float) * (target.values.size() + rest.values.size()); }
};

/// Splits the CT by the mask, voxel by voxel: target = weight * attenuation, rest = attenuation - target. Both are
/// cropped to their voxels other than zero. Holds at most a little over 2 times the CT's bytes.
/// @throws std::invalid_argument if the mask's grid is not a part of the CT's
BodyModel splitBodies(const CtVolume& ct, const TargetMask& mask);

/// The whole CT as the target.
BodyModel oneBody(const CtVolume& ct);
}  // namespace xray_tracking
