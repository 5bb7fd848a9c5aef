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

/// Of what two ways to store one CT may differ by: counts, relative, and lengths [mm].
constexpr double kRounding = 1e-6;

/// Bone voxels in cells along the patient's axes, whatever the axes of the CT's grid. The cells lie at multiples of
/// their edge, and a voxel counts for the eight nearest ones by its distance: with whole counts in cells that begin at
/// the grid's corner, rounding in a file moved so many voxels to the next cell that another vertebra had most.
struct BoneHistogram
{
  Eigen::Vector3d corner;  ///< centre of the first cell [mm]
  double cell;             ///< edge [mm]
  Eigen::Vector3i size;
  std::vector<double> counts;

  std::size_t offset(int x, int y, int z) const
  {
    return (static_cast<std::size_t>(z) * size.y() + y) * static_cast<std::size_t>(size.x()) + x;
  }

  void add(const Eigen::Vector3d& point)
  {
    const Eigen::Vector3d place = (point - corner) / cell;
    const Eigen::Vector3i low = place.cast<int>();
    const Eigen::Vector3d share = place - low.cast<double>();
    for (int n = 0; n < 8; ++n)
    {
      const Eigen::Vector3i step(n & 1, n >> 1 & 1, n >> 2);
      double weight = 1.0;
      for (int axis = 0; axis < 3; ++axis)
      {
        weight *= step[axis] == 1 ? share[axis] : 1.0 - share[axis];
      }
      counts[offset(low.x() + step.x(), low.y() + step.y(), low.z() + step.z())] += weight;
    }
  }
};

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
  const double voxels = edge / volume.grid.spacing().minCoeff();
  const int cells_per_edge = std::clamp(static_cast<int>(voxels + 1e-3), 1, 10);
  const Eigen::AlignedBox3d box = volume.grid.extent();
  BoneHistogram bone;
  bone.cell = edge / cells_per_edge;
  // A margin of one cube, so that bone at the volume's edge can lie in the middle of a cube.
  bone.corner = ((box.min().array() - edge) / bone.cell).floor() * bone.cell;
  bone.size = ((box.max() - bone.corner + Eigen::Vector3d::Constant(edge)) / bone.cell).array().ceil().cast<int>() + 2;
  bone.counts.assign(bone.offset(0, 0, bone.size.z()), 0.0);
  for (int k = 0; k < volume.grid.size.z(); ++k)
  {
    for (int j = 0; j < volume.grid.size.y(); ++j)
    {
      const std::int16_t* const row = &volume.hu[volume.grid.offset(0, j, k)];
      for (int i = 0; i < volume.grid.size.x(); ++i)
      {
        if (row[i] > kBoneHu)
        {
          bone.add(volume.grid.patient_from_index * Eigen::Vector3d(i, j, k));
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
  const Eigen::AlignedBox3d box = volume.grid.extent();
  const double third = box.sizes().z() / 3.0;
  // Of the cells that a cube sums, the first one's centre is half a cell inside.
  const double to_centre = 0.5 * (edge - bone.cell);
  const auto visit = [&](const auto& call)
  {
    for (int z = 0; z < bone.size.z(); ++z)
    {
      const double height = bone.corner.z() + bone.cell * z + to_centre - box.min().z();
      for (int y = 0; y < bone.size.y() && height > third - kRounding && height < 2.0 * third + kRounding; ++y)
      {
        for (int x = 0; x < bone.size.x(); ++x)
        {
          call(Eigen::Vector3d(x, y, z), bone.counts[bone.offset(x, y, z)]);
        }
      }
    }
  };
  double most = 0.0;
  visit([&](const Eigen::Vector3d&, double count) { most = std::max(most, count); });
  if (!(most >= 0.5))
  {
    throw std::runtime_error("bony target: no voxel over " + std::to_string(kBoneHu) +
                             " HU near the middle third of the CT");
  }
  // Many cubes hold all of a bone that is smaller than they are: their mean has it in the middle.
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int cubes = 0;
  visit(
      [&](const Eigen::Vector3d& cell, double count)
      {
        if (count >= (1.0 - kRounding) * most)
        {
          sum += bone.corner + bone.cell * cell + Eigen::Vector3d::Constant(to_centre);
          ++cubes;
        }
      });
  return sum / cubes;
}
}  // namespace xray_tracking
