#pragma once

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Exact line integrals [value * mm] in double precision, one ray at a time: what faster renderers are measured by.
/// Rays end neither at their source nor at a panel's distance from it: they start at the source and leave the volume.
///
/// The volume as cuboids of constant value around the voxel centres (Siddon, Med. Phys. 12(2), 1985).
/// @param ray in the patient frame
double integrateCuboids(const ScalarVolume& volume, const Ray& ray);

/// The volume as the trilinear interpolation of the voxels, falling to zero one voxel outside the outermost centres.
/// Between two crossings of the grid it is a cubic polynomial of the path length, which two-point Gauss-Legendre
/// quadrature integrates exactly.
/// @param ray in the patient frame
double integrateTrilinear(const ScalarVolume& volume, const Ray& ray);
}  // namespace xray_tracking
