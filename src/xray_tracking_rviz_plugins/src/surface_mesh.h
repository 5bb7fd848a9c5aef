#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Triangles in the patient frame [mm]; seen from outside, a triangle's points run anticlockwise.
struct SurfaceMesh
{
  std::vector<Eigen::Vector3f> points;
  std::vector<Eigen::Vector3f> normals;  ///< of points, outwards, length 1
  std::vector<std::array<std::uint32_t, 3>> triangles;

  double area() const;    ///< [mm^2]
  double volume() const;  ///< enclosed; of a closed surface [mm^3]
};

/// Where the volume's values are the threshold, outside being where they are below; closed, as beyond the grid is
/// below. Voxels much finer than a millimetre are averaged first. Flying edges, then decimation by quadrics (both
/// VTK's).
/// @param most_triangles about; more are decimated to so many
/// @param least_area pieces of a smaller surface are left out [mm^2]
/// @param stop set by another thread: comes back early with what is no result
SurfaceMesh isoSurface(const ScalarVolume& volume, float threshold, std::size_t most_triangles, double least_area,
                       const std::atomic<bool>& stop);

/// The connected pieces most of whose surface is where the mask is 0.999 and more.
SurfaceMesh piecesWithin(const SurfaceMesh& mesh, const ScalarVolume& mask);

/// The triangles all of whose points are at weights of 0.999 and more, and the others. Outside of the mask's grid
/// weights are 0.
void splitByMask(const SurfaceMesh& mesh, const ScalarVolume& mask, SurfaceMesh& inside, SurfaceMesh& outside);
}  // namespace xray_tracking
