#pragma once

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// The volume at half the resolution, by averages over boxes of two voxels along every axis that is not already 1.5
/// times as coarse as the finest. Beyond the last voxel of an odd axis counts as zero, so that integrals are kept.
ScalarVolume halved(const ScalarVolume& volume);

/// The volume convolved along every axis by a symmetric filter of three voxels and the given variance [mm^2]; a
/// negative variance sharpens. Beyond the grid counts as zero.
///
/// Gives a rendering the resolution that it is compared at, at no cost per rendering: square bins of edge b on the
/// panel have b^2 / 12 / magnification^2, linear interpolation of voxels of spacing h has h^2 / 6, and halved() adds
/// 5 / 6 h^2 to that.
ScalarVolume filtered(ScalarVolume volume, const Eigen::Vector3d& variance);
}  // namespace xray_tracking
