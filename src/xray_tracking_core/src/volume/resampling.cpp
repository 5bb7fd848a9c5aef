#include "xray_tracking_core/volume/resampling.h"

#include <algorithm>
#include <utility>

#include <tbb/parallel_for.h>

namespace xray_tracking
{
ScalarVolume halved(const ScalarVolume& volume)
{
  const Eigen::Vector3d spacing = volume.grid.spacing();
  const Eigen::Vector3i& size = volume.grid.size;
  Eigen::Vector3i factor;
  for (int axis = 0; axis < 3; ++axis)
  {
    factor[axis] = spacing[axis] < 1.5 * spacing.minCoeff() ? 2 : 1;
  }
  ScalarVolume half;
  half.grid.size = (size + factor - Eigen::Vector3i::Ones()).cwiseQuotient(factor);
  // Voxel n is the middle of voxels factor * n to factor * n + factor - 1.
  half.grid.patient_from_index = volume.grid.patient_from_index *
                                 Eigen::Translation3d(0.5 * (factor - Eigen::Vector3i::Ones()).cast<double>()) *
                                 Eigen::Scaling(Eigen::Vector3d(factor.cast<double>()));
  half.values.resize(half.grid.voxelCount());
  const float share = 1.0f / static_cast<float>(factor.prod());
  tbb::parallel_for(0, half.grid.size.z(),
                    [&](int k)
                    {
                      for (int j = 0; j < half.grid.size.y(); ++j)
                      {
                        float* to = half.values.data() + half.grid.offset(0, j, k);
                        for (int z = k * factor.z(); z < std::min((k + 1) * factor.z(), size.z()); ++z)
                        {
                          for (int y = j * factor.y(); y < std::min((j + 1) * factor.y(), size.y()); ++y)
                          {
                            const float* from = volume.values.data() + volume.grid.offset(0, y, z);
                            for (int x = 0; x < size.x(); ++x)
                            {
                              to[x / factor.x()] += share * from[x];
                            }
                          }
                        }
                      }
                    });
  return half;
}

ScalarVolume filtered(ScalarVolume volume, const Eigen::Vector3d& variance)
{
  const Eigen::Vector3i size = volume.grid.size;
  const Eigen::Vector3d weight = 0.5 * variance.array() / volume.grid.spacing().array().square();
  ScalarVolume from = std::move(volume);
  ScalarVolume to{ from.grid, std::vector<float>(from.values.size()) };
  for (int axis = 0; axis < 3; ++axis)
  {
    const float beside = static_cast<float>(weight[axis]);
    const float centre = 1.0f - 2.0f * beside;
    tbb::parallel_for(0, size.z(),
                      [&](int k)
                      {
                        Eigen::Vector3i voxel(0, 0, k);
                        for (voxel.y() = 0; voxel.y() < size.y(); ++voxel.y())
                        {
                          for (voxel.x() = 0; voxel.x() < size.x(); ++voxel.x())
                          {
                            const auto value = [&](int step)
                            {
                              Eigen::Vector3i at = voxel;
                              at[axis] += step;
                              const bool inside = at[axis] >= 0 && at[axis] < size[axis];
                              return inside ? from.values[from.grid.offset(at.x(), at.y(), at.z())] : 0.0f;
                            };
                            to.values[to.grid.offset(voxel.x(), voxel.y(), voxel.z())] =
                                centre * value(0) + beside * (value(-1) + value(1));
                          }
                        }
                      });
    std::swap(from.values, to.values);
  }
  return from;
}
}  // namespace xray_tracking
