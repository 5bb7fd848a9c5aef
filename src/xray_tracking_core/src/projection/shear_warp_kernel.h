#pragma once

// Shared by translation units that are compiled for different processors: nothing inline that has external linkage
// may be defined or used here, or the linker might keep the copy that other processors cannot run.

#include <cstddef>
#include <cstdint>

namespace xray_tracking
{
namespace shear_warp
{
/// A row block's part that holds values other than zero; empty if last < first.
struct RowExtent
{
  std::int16_t first;
  std::int16_t last;
};

/// Rows of a slice that share a RowExtent.
constexpr int kRowsPerExtent = 8;
/// Voxel rows that a call of accumulate() may need of a slice.
constexpr int kVoxelRowsPerCall = 16;
/// Rows of the base plane that a call of accumulate() may take.
constexpr int kBaseRowsPerCall = 60;
/// The base plane's columns are a multiple of this.
constexpr int kBaseColumnGranule = 16;
/// Zeros before and behind each row of voxels, one row's being the next one's.
constexpr int kMargin = 16;
/// A step on the base plane must advance by less than this in every slice [voxel]: then what a vector of neighbours
/// needs lies in one vector of voxels.
constexpr double kMaxStep = 0.85;
/// Floats a point in the output of warpWithDerivatives.
constexpr int kParameters = 6;

/// Where the base plane's points lie in a slice [voxel]: column = column_at_zero + column_step * base column.
struct SliceView
{
  float column_at_zero;
  float column_step;
  float row_at_zero;
  float row_step;
  float moment_weight;  ///< of the slice in BasePlane::moment
};

/// The volume, its slices across the main axis.
struct SliceStack
{
  const std::int16_t* voxels;  ///< of the first slice; kMargin before and behind each row are zeros
  std::ptrdiff_t slice_stride;
  std::ptrdiff_t row_stride;
  int columns;               ///< neighbours in memory
  int rows;                  ///< kVoxelRowsPerCall may be read of fewer, and are zeros
  const RowExtent* extents;  ///< of the first slice, extents_per_slice for each
  int extents_per_slice;
  const SliceView* views;
  int slices;
};

struct BasePlane
{
  float* sum;     ///< of all slices
  float* moment;  ///< of all slices times their moment_weight; null if not wanted
  int columns;    ///< a multiple of kBaseColumnGranule; also the stride
};

/// A term of a filter on the base plane.
struct FilterTap
{
  std::ptrdiff_t offset;
  float weight;
};

/// A row of points to be sampled. With n the point's number in the row: base column = (column_0 + n * column_n) / w,
/// base row alike, w = w_0 + n * w_n > 0; the line integral = sum * sqrt(q_0 + n * q_n + n^2 * q_nn) / w.
struct WarpRow
{
  float column_0, column_n;
  float row_0, row_n;
  float w_0, w_n;
  float q_0, q_n, q_nn;
  int count;
  float* integrals;
};

/// Positions on the base plane are kept within these, beyond which it holds zeros.
struct WarpLimits
{
  float min_column, max_column;
  float min_row, max_row;
};

/// What derivatives need beyond WarpRow; index axes: column, row, main.
struct WarpDerivatives
{
  float index_from_room[3][3];  ///< linear part
  float ray_0[3];               ///< room, from the source to the row's first point [mm]
  float ray_n[3];               ///< and what the next point adds
  float from_centre[3];         ///< room, from the centre of rotation to the source [mm]
  float depth;                  ///< base plane's position less the source's along the main axis [voxel]
  float points_per_column;      ///< base points per voxel
  float points_per_row;
  float* output;  ///< kParameters for every point
};

struct Kernels
{
  /// Sums all slices into rows of the base plane, kBaseRowsPerCall at most, that kVoxelRowsPerCall rows of each slice
  /// suffice for.
  void (*accumulate)(const SliceStack& stack, const BasePlane& base, int first_row, int row_count);
  /// Filters a row of `from`, which must be readable at all offsets from it, into `to`.
  void (*filter)(const BasePlane& from, const FilterTap* taps, int tap_count, const BasePlane& to, int row);
  void (*warp)(const BasePlane& base, const WarpLimits& limits, const WarpRow& row);
  void (*warpWithDerivatives)(const BasePlane& base, const WarpLimits& limits, const WarpRow& row,
                              const WarpDerivatives& derivatives);
};

extern const Kernels kGenericKernels;
#ifdef __x86_64__
extern const Kernels kAvx2Kernels;
extern const Kernels kAvx512Kernels;
#endif
}  // namespace shear_warp
}  // namespace xray_tracking
