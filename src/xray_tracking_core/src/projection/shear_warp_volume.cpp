#include "shear_warp_volume.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

namespace xray_tracking
{
namespace shear_warp
{
namespace
{
constexpr float kLargest = 32767.0f;
/// Voxels added to every plane, so that planes of 2^n voxels do not compete for the same cache lines.
constexpr std::ptrdiff_t kPlanePadding = 32;

struct Content
{
  Eigen::AlignedBox3i box;
  float largest = 0.0f;
  bool finite = true;

  void add(const Content& other)
  {
    box.extend(other.box);
    largest = std::max(largest, other.largest);
    finite = finite && other.finite;
  }
};

Content findContent(const ScalarVolume& volume)
{
  const Eigen::Vector3i& size = volume.grid.size;
  return tbb::parallel_reduce(
      tbb::blocked_range<int>(0, size.z()), Content(),
      [&](const tbb::blocked_range<int>& planes, Content content)
      {
        for (int k = planes.begin(); k != planes.end(); ++k)
        {
          for (int j = 0; j < size.y(); ++j)
          {
            const float* row = volume.values.data() + volume.grid.offset(0, j, k);
            const auto is_content = [](float value) { return value != 0.0f; };
            const float* first = std::find_if(row, row + size.x(), is_content);
            if (first == row + size.x())
            {
              continue;
            }
            const float* last = row + size.x() - 1;
            while (!is_content(*last))
            {
              --last;
            }
            content.box.extend(Eigen::Vector3i(first - row, j, k));
            content.box.extend(Eigen::Vector3i(last - row, j, k));
            for (const float* value = first; value <= last; ++value)
            {
              content.finite = content.finite && std::isfinite(*value);
              content.largest = std::max(content.largest, std::abs(*value));
            }
          }
        }
        return content;
      },
      [](Content a, const Content& b)
      {
        a.add(b);
        return a;
      });
}
}  // namespace

StackedVolume::StackedVolume(const ScalarVolume& volume)
{
  const VolumeGrid& grid = volume.grid;
  if (grid.size.minCoeff() < 1 || volume.values.size() != grid.voxelCount())
  {
    throw std::invalid_argument("DRR renderer: the volume is empty or not of its grid's size");
  }
  if (grid.size.maxCoeff() > 32767)
  {
    throw std::invalid_argument("DRR renderer: the volume has " + std::to_string(grid.size.maxCoeff()) +
                                " voxels along an axis: expected 32767 or fewer");
  }
  index_from_patient_ = grid.patient_from_index.inverse();
  if (!index_from_patient_.matrix().allFinite())
  {
    throw std::invalid_argument("DRR renderer: the volume's axes do not span space");
  }
  const Content content = findContent(volume);
  if (!content.finite)
  {
    throw std::invalid_argument("DRR renderer: the volume holds a value that is not finite");
  }
  if (content.box.isEmpty())
  {
    return;
  }
  corner_ = content.box.min();
  size_ = content.box.sizes() + Eigen::Vector3i::Ones();
  index_from_patient_.pretranslate(-corner_.cast<double>());
  scale_ = content.largest / kLargest;
  along_i_ = makeCopy(volume, 0, 1, 2);
  along_j_ = makeCopy(volume, 1, 2, 0);
  for (int main = 0; main < 3; ++main)
  {
    extents_[main] = findExtents(main);
  }
}

StackedVolume::Axes StackedVolume::axes(int main)
{
  switch (main)
  {
    case 0:
      return { 1, 2, 0 };
    case 1:
      return { 0, 2, 1 };
    default:
      return { 0, 1, 2 };
  }
}

StackedVolume::Copy StackedVolume::makeCopy(const ScalarVolume& volume, int column_axis, int row_axis,
                                            int plane_axis) const
{
  Copy copy;
  copy.row_stride = size_[column_axis] + kMargin;
  copy.plane_stride = copy.row_stride * std::max(size_[row_axis], kVoxelRowsPerCall) + kPlanePadding;
  copy.voxels.assign(kMargin + copy.plane_stride * std::max(size_[plane_axis], kVoxelRowsPerCall), 0);
  std::array<std::ptrdiff_t, 3> stride;
  stride[column_axis] = 1;
  stride[row_axis] = copy.row_stride;
  stride[plane_axis] = copy.plane_stride;
  const float inverse_scale = 1.0f / scale_;
  // Tiles of 32 x 32 keep the transposed copy's lines in cache.
  tbb::parallel_for(tbb::blocked_range<int>(0, size_.z(), 1),
                    [&](const tbb::blocked_range<int>& planes)
                    {
                      constexpr int kTile = 32;
                      for (int k = planes.begin(); k != planes.end(); ++k)
                      {
                        for (int tile = 0; tile < size_.x(); tile += kTile)
                        {
                          for (int j = 0; j < size_.y(); ++j)
                          {
                            const float* from = volume.values.data() +
                                                volume.grid.offset(corner_.x(), corner_.y() + j, corner_.z() + k);
                            std::int16_t* to = copy.voxels.data() + kMargin + j * stride[1] + k * stride[2];
                            for (int i = tile; i < std::min(tile + kTile, size_.x()); ++i)
                            {
                              to[i * stride[0]] = static_cast<std::int16_t>(std::lrint(from[i] * inverse_scale));
                            }
                          }
                        }
                      }
                    });
  return copy;
}

std::vector<RowExtent> StackedVolume::findExtents(int main) const
{
  const SliceStack slices = stack(main);
  std::vector<RowExtent> extents(static_cast<std::size_t>(slices.extents_per_slice) * slices.slices,
                                 RowExtent{ 32767, -1 });
  tbb::parallel_for(0, slices.slices,
                    [&](int slice)
                    {
                      for (int row = 0; row < slices.rows; ++row)
                      {
                        RowExtent& extent = extents[slice * slices.extents_per_slice + row / kRowsPerExtent];
                        const std::int16_t* voxels =
                            slices.voxels + slice * slices.slice_stride + row * slices.row_stride;
                        int first = 0;
                        while (first < extent.first && first < slices.columns && voxels[first] == 0)
                        {
                          ++first;
                        }
                        int last = slices.columns - 1;
                        while (last > extent.last && voxels[last] == 0)
                        {
                          --last;
                        }
                        if (first < slices.columns)
                        {
                          extent.first = static_cast<std::int16_t>(std::min<int>(extent.first, first));
                          extent.last = static_cast<std::int16_t>(std::max<int>(extent.last, last));
                        }
                      }
                    });
  return extents;
}

SliceStack StackedVolume::stack(int main) const
{
  SliceStack stack = {};
  const Axes axes = StackedVolume::axes(main);
  const Copy& copy = main == 0 ? along_j_ : along_i_;
  stack.voxels = copy.voxels.data() + kMargin;
  stack.row_stride = axes.row == 1 || main == 0 ? copy.row_stride : copy.plane_stride;
  stack.slice_stride = main == 1 ? copy.row_stride : copy.plane_stride;
  stack.columns = size_[axes.column];
  stack.rows = size_[axes.row];
  stack.slices = size_[main];
  stack.extents = extents_[main].data();
  stack.extents_per_slice = (stack.rows + kRowsPerExtent - 1) / kRowsPerExtent;
  return stack;
}

std::size_t StackedVolume::memory() const
{
  std::size_t bytes = (along_i_.voxels.size() + along_j_.voxels.size()) * sizeof(std::int16_t);
  for (const std::vector<RowExtent>& extents : extents_)
  {
    bytes += extents.size() * sizeof(RowExtent);
  }
  return bytes;
}
}  // namespace shear_warp
}  // namespace xray_tracking
