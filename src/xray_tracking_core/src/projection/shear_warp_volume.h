#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "shear_warp_kernel.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
namespace shear_warp
{
/// A volume's bounding box of values other than zero as stacks of slices across each axis. Two copies in 16 bits serve
/// all three: rows along i for slices across j and k, rows along j for slices across i.
class StackedVolume
{
public:
  /// Index axes as seen by slices across `main`.
  struct Axes
  {
    int column;  ///< neighbours in memory
    int row;
    int main;
  };

  /// @throws std::invalid_argument
  explicit StackedVolume(const ScalarVolume& volume);

  /// Whether all values are zero.
  bool empty() const { return size_.minCoeff() < 1; }
  const Eigen::Vector3i& size() const { return size_; }
  /// To the continuous index in the bounding box.
  const Eigen::Affine3d& indexFromPatient() const { return index_from_patient_; }
  /// Value of one step of the 16 bit values.
  float scale() const { return scale_; }
  std::size_t memory() const;

  static Axes axes(int main);
  /// Slices across `main`, without views.
  SliceStack stack(int main) const;

private:
  struct Copy
  {
    std::ptrdiff_t row_stride;
    std::ptrdiff_t plane_stride;
    std::vector<std::int16_t> voxels;
  };

  Copy makeCopy(const ScalarVolume& volume, int column_axis, int row_axis, int plane_axis) const;
  std::vector<RowExtent> findExtents(int main) const;

  Eigen::Vector3i corner_ = Eigen::Vector3i::Zero();  ///< the bounding box's first voxel
  Eigen::Vector3i size_ = Eigen::Vector3i::Zero();
  Eigen::Affine3d index_from_patient_;
  float scale_ = 0.0f;
  Copy along_i_;  ///< i fastest, then j, k
  Copy along_j_;  ///< j fastest, then k, i
  std::array<std::vector<RowExtent>, 3> extents_;
};
}  // namespace shear_warp
}  // namespace xray_tracking
