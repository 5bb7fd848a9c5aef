#include "xray_tracking_core/volume/body_model.h"

#include <algorithm>
#include <stdexcept>

#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
/// Leaves out the planes at the borders that hold zeros alone; in place, as the kept voxels only move forward.
void crop(ScalarVolume& volume)
{
  const VolumeGrid& grid = volume.grid;
  Eigen::AlignedBox3i used;
  for (int k = 0; k < grid.size.z(); ++k)
  {
    for (int j = 0; j < grid.size.y(); ++j)
    {
      const float* row = volume.values.data() + grid.offset(0, j, k);
      const float* end = row + grid.size.x();
      const float* first = std::find_if(row, end, [](float value) { return value != 0.0f; });
      if (first != end)
      {
        const float* last = end - 1;
        while (*last == 0.0f)
        {
          --last;
        }
        used.extend(Eigen::Vector3i(static_cast<int>(first - row), j, k));
        used.extend(Eigen::Vector3i(static_cast<int>(last - row), j, k));
      }
    }
  }
  if (used.isEmpty())
  {
    volume = ScalarVolume();
    return;
  }
  if (used.sizes() + Eigen::Vector3i::Ones() == grid.size)
  {
    return;
  }
  VolumeGrid kept;
  kept.size = used.max() - used.min() + Eigen::Vector3i::Ones();
  kept.patient_from_index = grid.patient_from_index * Eigen::Translation3d(used.min().cast<double>());
  for (int k = 0; k < kept.size.z(); ++k)
  {
    for (int j = 0; j < kept.size.y(); ++j)
    {
      const float* from = volume.values.data() + grid.offset(used.min().x(), used.min().y() + j, used.min().z() + k);
      std::copy(from, from + kept.size.x(), volume.values.data() + kept.offset(0, j, k));
    }
  }
  volume.grid = kept;
  // What is left over is not given back: a copy would take more than that, and bodies do not live long.
  volume.values.resize(kept.voxelCount());
}
}  // namespace

BodyModel splitBodies(const CtVolume& ct, const TargetMask& mask)
{
  const Eigen::Affine3d ct_from_mask = ct.grid.patient_from_index.inverse() * mask.grid.patient_from_index;
  const Eigen::Vector3i first = ct_from_mask.translation().array().round().cast<int>();
  const Eigen::Vector3i end = first + mask.grid.size;
  if (!ct_from_mask.isApprox(Eigen::Affine3d(Eigen::Translation3d(first.cast<double>())), 1e-6) ||
      first.minCoeff() < 0 || (end.array() > ct.grid.size.array()).any() ||
      mask.values.size() != mask.grid.voxelCount())
  {
    throw std::invalid_argument("target mask: expected a part of the CT's grid");
  }
  BodyModel bodies{ { mask.grid, std::vector<float>(mask.values.size()) }, attenuationVolume(ct) };
  std::size_t n = 0;
  for (int k = first.z(); k < end.z(); ++k)
  {
    for (int j = first.y(); j < end.y(); ++j)
    {
      float* rest = bodies.rest.values.data() + ct.grid.offset(first.x(), j, k);
      for (int i = 0; i < mask.grid.size.x(); ++i, ++n)
      {
        bodies.target.values[n] = mask.values[n] * rest[i];
        rest[i] -= bodies.target.values[n];
      }
    }
  }
  crop(bodies.target);
  crop(bodies.rest);
  return bodies;
}

BodyModel oneBody(const CtVolume& ct)
{
  BodyModel bodies{ attenuationVolume(ct), {} };
  crop(bodies.target);
  return bodies;
}
}  // namespace xray_tracking
