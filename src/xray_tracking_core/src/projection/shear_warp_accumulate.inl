// Sums slices into the base plane; a part of shear_warp_kernel.inl.

/// Voxel rows that kAccumulators steps of kMaxStep reach, with the one above and one for rounding.
constexpr int kMaxRows = static_cast<int>(kAccumulators * kMaxStep) + 3;

/// A slice as seen by a block of rows of the base plane.
struct SliceRows
{
  const std::int16_t* first_voxel_row;  ///< row number first_row, which may lie outside
  int first_row;
  int row_count;
  int first_column;  ///< base columns that values other than zero reach: a multiple of kLanes
  int last_column;
  float column_at_zero;
  float column_step;
  float moment_weight;
  int offset[kAccumulators];   ///< of the voxel row below, in floats, in the resampled rows
  float share[kAccumulators];  ///< of the voxel row above
};

/// @return false if the rows see nothing of the slice
inline bool viewSlice(const SliceStack& stack, int slice, const BasePlane& base, int base_row, SliceRows& rows)
{
  const SliceView& view = stack.views[slice];
  const float lowest = -1.0f;
  const float highest = static_cast<float>(stack.rows);
  const float at_first = view.row_at_zero + view.row_step * static_cast<float>(base_row);
  const float at_last = at_first + view.row_step * static_cast<float>(kAccumulators - 1);
  if (!(at_last > lowest) || !(at_first < highest))
  {
    return false;
  }
  rows.first_row = floorToInt(clampFloat(at_first, lowest, highest));
  rows.row_count = floorToInt(clampFloat(at_last, lowest, highest)) + 2 - rows.first_row;

  const RowExtent* extents = stack.extents + static_cast<std::ptrdiff_t>(slice) * stack.extents_per_slice;
  const int first_extent = clampInt(rows.first_row, 0, stack.rows - 1) / kRowsPerExtent;
  const int last_extent = clampInt(rows.first_row + rows.row_count - 1, 0, stack.rows - 1) / kRowsPerExtent;
  int first_voxel = extents[first_extent].first;
  int last_voxel = extents[first_extent].last;
  for (int n = first_extent + 1; n <= last_extent; ++n)
  {
    first_voxel = extents[n].first < first_voxel ? extents[n].first : first_voxel;
    last_voxel = extents[n].last > last_voxel ? extents[n].last : last_voxel;
  }
  if (last_voxel < first_voxel)
  {
    return false;
  }
  const float inverse_step = 1.0f / view.column_step;
  const float from = (static_cast<float>(first_voxel - 1) - view.column_at_zero) * inverse_step;
  const float to = (static_cast<float>(last_voxel + 1) - view.column_at_zero) * inverse_step;
  const float last_base_column = static_cast<float>(base.columns - 1);
  if (to < 0.0f || from > last_base_column)
  {
    return false;
  }
  rows.first_column = static_cast<int>(clampFloat(from, 0.0f, last_base_column)) / kLanes * kLanes;
  rows.last_column = static_cast<int>(clampFloat(to, 0.0f, last_base_column));

  rows.column_at_zero = view.column_at_zero;
  rows.column_step = view.column_step;
  rows.moment_weight = view.moment_weight;
  rows.first_voxel_row = stack.voxels + slice * stack.slice_stride + rows.first_row * stack.row_stride;
  for (int q = 0; q < kAccumulators; ++q)
  {
    const float at = clampFloat(at_first + view.row_step * static_cast<float>(q), lowest, highest);
    const int below = floorToInt(at);
    rows.offset[q] = (below - rows.first_row) * kLanes;
    rows.share[q] = at - static_cast<float>(below);
  }
  return true;
}

/// Voxels ahead: a block reads more rows at once than the processor foresees by itself.
constexpr int kPrefetch = 32;

/// Interpolates the slice's voxel rows at kLanes base columns.
inline void resampleRows(const SliceStack& stack, const SliceRows& rows, int column, float* resampled)
{
  const float at_first = rows.column_at_zero + rows.column_step * static_cast<float>(column);
  // Kept inside the row; lanes that lie outside get no weight.
  const int start = clampInt(floorToInt(at_first), 0, stack.columns - kLanes);
  const Floats at = (at_first - static_cast<float>(start)) + rows.column_step * laneNumbers();
  Ints left = __builtin_convertvector(at, Ints);
  left += toFloats(left) > at;
  const Ints right = left + 1;
  const Floats share = at - toFloats(left);
  const Floats left_weight = whereLane(left, 1.0f - share);
  const Floats right_weight = whereLane(right, share);

  const std::int16_t* voxels = rows.first_voxel_row + start;
  for (int n = 0; n < rows.row_count; ++n, voxels += stack.row_stride)
  {
    Floats row = {};
    if (static_cast<unsigned>(rows.first_row + n) < static_cast<unsigned>(stack.rows))
    {
      __builtin_prefetch(voxels + kPrefetch);
      const Floats values = loadVoxels(voxels);
      row = left_weight * permute(values, left) + right_weight * permute(values, right);
    }
    store(resampled + n * kLanes, row);
  }
}

template <bool with_moment>
inline void accumulateColumns(const SliceStack& stack, const SliceRows* slices, int slice_count, const BasePlane& base,
                              int base_row, int column)
{
  constexpr int kRows = with_moment ? kAccumulators / 2 : kAccumulators;
  alignas(64) float resampled[kMaxRows * kLanes];
  for (int first = 0; first < kAccumulators; first += kRows)
  {
    const std::ptrdiff_t offset = static_cast<std::ptrdiff_t>(base_row + first) * base.columns + column;
    Floats sum[kRows];
    Floats moment[kRows];
#pragma GCC unroll 16
    for (int q = 0; q < kRows; ++q)
    {
      sum[q] = load<Floats>(base.sum + offset + q * base.columns);
      if (with_moment)
      {
        moment[q] = load<Floats>(base.moment + offset + q * base.columns);
      }
    }
    for (int n = 0; n < slice_count; ++n)
    {
      const SliceRows& rows = slices[n];
      if (column < rows.first_column || column > rows.last_column)
      {
        continue;
      }
      resampleRows(stack, rows, column, resampled);
#pragma GCC unroll 16
      for (int q = 0; q < kRows; ++q)
      {
        const float* below = resampled + rows.offset[first + q];
        const float share = rows.share[first + q];
        const Floats low = load<Floats>(below);
        const Floats high = load<Floats>(below + kLanes);
        if (with_moment)
        {
          const Floats value = low + share * (high - low);
          sum[q] += value;
          moment[q] += rows.moment_weight * value;
        }
        else
        {
          sum[q] += (1.0f - share) * low;
          sum[q] += share * high;
        }
      }
    }
#pragma GCC unroll 16
    for (int q = 0; q < kRows; ++q)
    {
      store(base.sum + offset + q * base.columns, sum[q]);
      if (with_moment)
      {
        store(base.moment + offset + q * base.columns, moment[q]);
      }
    }
  }
}

void accumulate(const SliceStack& stack, const BasePlane& base, int first_row)
{
  // A chunk of slices is small enough for neighbouring columns to find its cache lines again, and large enough for the
  // sums to stay in registers for a while.
  constexpr int kChunk = 64;
  SliceRows rows[kChunk];
  const std::size_t bytes = sizeof(float) * kBaseRowsPerCall * base.columns;
  __builtin_memset(base.sum + static_cast<std::ptrdiff_t>(first_row) * base.columns, 0, bytes);
  if (base.moment)
  {
    __builtin_memset(base.moment + static_cast<std::ptrdiff_t>(first_row) * base.columns, 0, bytes);
  }
  for (int base_row = first_row; base_row < first_row + kBaseRowsPerCall; base_row += kAccumulators)
  {
    for (int slice = 0; slice < stack.slices;)
    {
      int count = 0;
      int first_column = base.columns;
      int last_column = -1;
      for (; slice < stack.slices && count < kChunk; ++slice)
      {
        if (viewSlice(stack, slice, base, base_row, rows[count]))
        {
          first_column = rows[count].first_column < first_column ? rows[count].first_column : first_column;
          last_column = rows[count].last_column > last_column ? rows[count].last_column : last_column;
          ++count;
        }
      }
      for (int column = first_column; column <= last_column; column += kLanes)
      {
        if (base.moment)
        {
          accumulateColumns<true>(stack, rows, count, base, base_row, column);
        }
        else
        {
          accumulateColumns<false>(stack, rows, count, base, base_row, column);
        }
      }
    }
  }
}

inline void filterRow(const float* from, const FilterTap* taps, int tap_count, float* to, int columns)
{
  for (int column = 0; column < columns; column += kLanes)
  {
    Floats sum = {};
    for (int n = 0; n < tap_count; ++n)
    {
      sum += taps[n].weight * load<Floats>(from + column + taps[n].offset);
    }
    store(to + column, sum);
  }
}

void filter(const BasePlane& from, const FilterTap* taps, int tap_count, const BasePlane& to, int row)
{
  const std::ptrdiff_t offset = static_cast<std::ptrdiff_t>(row) * from.columns;
  filterRow(from.sum + offset, taps, tap_count, to.sum + offset, from.columns);
  if (from.moment)
  {
    filterRow(from.moment + offset, taps, tap_count, to.moment + offset, from.columns);
  }
}
