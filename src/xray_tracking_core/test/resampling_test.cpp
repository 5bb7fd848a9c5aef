#include "xray_tracking_core/volume/resampling.h"

#include <gtest/gtest.h>

#include "drr_samples.h"

namespace xray_tracking
{
namespace
{
TEST(FilteredTest, AddsItsVariance)
{
  // A single voxel becomes a product of three-point distributions; sharpening by as much has the opposite variance.
  const VolumeGrid grid = makeGrid({ 9, 9, 9 }, { 1.0, 0.8, 2.0 });
  const ScalarVolume volume = fill(grid, [](const Eigen::Vector3d& p) { return p.norm() < 0.1 ? 1.0 : 0.0; });
  for (const double sign : { 1.0, -1.0 })
  {
    const Eigen::Vector3d variance = sign * Eigen::Vector3d(0.2, 0.1, 0.7);
    const ScalarVolume result = filtered(volume, variance);
    double sum = 0.0;
    Eigen::Vector3d squares = Eigen::Vector3d::Zero();
    for (int n = 0; n < 9 * 9 * 9; ++n)
    {
      const Eigen::Vector3d p = grid.patient_from_index * Eigen::Vector3d(n % 9, n / 9 % 9, n / 81);
      sum += result.values[n];
      squares += result.values[n] * p.cwiseAbs2();
    }
    EXPECT_NEAR(sum, 1.0, 1e-6);
    EXPECT_LT((squares - variance).norm(), 1e-6);
  }
}

TEST(HalvedTest, KeepsIntegralsAndPlace)
{
  const ScalarVolume volume = fill(makeGrid({ 65, 64, 21 }, { 1.0, 1.0, 3.0 }), blobs);
  const ScalarVolume half = halved(volume);
  EXPECT_EQ(half.grid.size, Eigen::Vector3i(33, 32, 21));
  const auto moments = [](const ScalarVolume& v)
  {
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    for (int k = 0; k < v.grid.size.z(); ++k)
    {
      for (int j = 0; j < v.grid.size.y(); ++j)
      {
        for (int i = 0; i < v.grid.size.x(); ++i)
        {
          const Eigen::Vector3d p = v.grid.patient_from_index * Eigen::Vector3d(i, j, k);
          sum += v.values[v.grid.offset(i, j, k)] * p.homogeneous();
        }
      }
    }
    return Eigen::Vector4d(sum * v.grid.spacing().prod());
  };
  EXPECT_LT((moments(half) - moments(volume)).norm(), 1e-4 * moments(volume).w());
}
}  // namespace
}  // namespace xray_tracking
