#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
namespace
{
constexpr int kBoneHu = 200;

/// Bone voxels counted in cells along the patient's axes, whatever the axes of the CT's grid.
struct BoneHistogram
{
  Eigen::Vector3d corner;  ///< of the first cell [mm]
  double cell;             ///< edge [mm]
  Eigen::Vector3i size;
  std::vector<std::int64_t> counts;

  std::size_t offset(int x, int y, int z) const
  {
    return (static_cast<std::size_t>(z) * size.y() + y) * static_cast<std::size_t>(size.x()) + x;
  }
};

Eigen::AlignedBox3d boundingBox(const VolumeGrid& grid)
{
  Eigen::AlignedBox3d box;
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Array3d upper(corner & 1, (corner >> 1) & 1, corner >> 2);
    box.extend(Eigen::Vector3d(grid.patient_from_index * (upper * (grid.size.cast<double>().array() - 1.0)).matrix()));
  }
  return box;
}

/// Replaces every count by the sum over `cells` cells along each axis that start there.
void sumOverCubes(BoneHistogram& bone, int cells)
{
  const std::array<std::size_t, 3> strides{ 1, bone.offset(0, 1, 0), bone.offset(0, 0, 1) };
  for (int axis = 0; axis < 3; ++axis)
  {
    for (std::size_t cell = 0; cell < bone.counts.size(); ++cell)
    {
      // In place: those that follow along the axis are not yet summed.
      const int place = static_cast<int>(cell / strides[axis] % bone.size[axis]);
      for (int n = 1; n < std::min(cells, bone.size[axis] - place); ++n)
      {
        bone.counts[cell] += bone.counts[cell + n * strides[axis]];
      }
    }
  }
}

/// How many bone voxels every cube of the given edge holds, addressed by its lowest cell.
BoneHistogram cubesOfBone(const CtVolume& volume, double edge)
{
  // No finer than the voxels, or most cells would be empty.
  const int cells_per_edge = std::clamp(static_cast<int>(edge / volume.grid.spacing().minCoeff()), 1, 10);
  const Eigen::AlignedBox3d box = boundingBox(volume.grid);
  BoneHistogram bone;
  bone.cell = edge / cells_per_edge;
  // A margin of one cube, so that bone at the volume's edge can lie in the middle of a cube.
  bone.corner = box.min() - Eigen::Vector3d::Constant(edge);
  bone.size = ((box.sizes() + Eigen::Vector3d::Constant(2.0 * edge)) / bone.cell).array().ceil().cast<int>() + 1;
  bone.counts.assign(bone.offset(0, 0, bone.size.z()), 0);
  for (int k = 0; k < volume.grid.size.z(); ++k)
  {
    for (int j = 0; j < volume.grid.size.y(); ++j)
    {
      for (int i = 0; i < volume.grid.size.x(); ++i)
      {
        if (volume.hu[volume.grid.offset(i, j, k)] > kBoneHu)
        {
          const Eigen::Vector3d point = volume.grid.patient_from_index * Eigen::Vector3d(i, j, k);
          const Eigen::Vector3i cell = ((point - bone.corner) / bone.cell).cast<int>();
          ++bone.counts[bone.offset(cell.x(), cell.y(), cell.z())];
        }
      }
    }
  }
  sumOverCubes(bone, cells_per_edge);
  return bone;
}
}  // namespace

Eigen::Vector3d findBonyTarget(const CtVolume& volume, double edge)
{
  const double finest = volume.grid.spacing().minCoeff();
  if (!(edge >= finest) || !std::isfinite(edge))
  {
    throw std::invalid_argument("bony target: edge is " + std::to_string(edge) + " mm, expected at least a voxel, " +
                                std::to_string(finest) + " mm");
  }
  const BoneHistogram bone = cubesOfBone(volume, edge);
  const Eigen::AlignedBox3d box = boundingBox(volume.grid);
  const double third = box.sizes().z() / 3.0;

  // Many cubes hold all of a bone that is smaller than they are: their mean has it in the middle.
  std::int64_t most = 1;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int cubes = 0;
  for (int z = 0; z < bone.size.z(); ++z)
  {
    for (int y = 0; y < bone.size.y(); ++y)
    {
      for (int x = 0; x < bone.size.x(); ++x)
      {
        const std::int64_t count = bone.counts[bone.offset(x, y, z)];
        const Eigen::Vector3d centre =
            bone.corner + bone.cell * Eigen::Vector3d(x, y, z) + Eigen::Vector3d::Constant(edge / 2);
        const double height = centre.z() - box.min().z();
        if (count < most || height < third || height > 2.0 * third)
        {
          continue;
        }
        if (count > most)
        {
          most = count;
          sum.setZero();
          cubes = 0;
        }
        sum += centre;
        ++cubes;
      }
    }
  }
  if (cubes == 0)
  {
    throw std::runtime_error("bony target: no voxel over " + std::to_string(kBoneHu) +
                             " HU near the middle third of the CT");
  }
  return sum / cubes;
}
}  // namespace xray_tracking
