// Sums slices into the base plane; a part of shear_warp_kernel.inl.
//
// From slice to slice the base plane's points drift: along the columns by a voxel or so where the view is oblique, but
// along the rows mostly by hundredths of one. A group of slices is thus interpolated along the columns and summed,
// voxel row by voxel row, before the sum is interpolated along the rows.

/// What rows may drift by from a group's first slice to its last [voxel]. Slices before the group's middle and behind
/// it are off to opposite sides, so that what this costs is small of second order.
constexpr float kMaxDrift = 0.1f;
/// Slices in a group, so that sums of 16 bit voxels times kOne fit 32 bits; with moments, weighted sums.
constexpr int kMaxGroup = 16;
constexpr int kMaxMomentGroup = 7;
static_assert(32768ll * kOne * kMaxGroup < (1ll << 31), "a group's sum must fit");
static_assert(32768ll * kOne * kMaxMomentGroup * (kMaxMomentGroup + 1) / 2 < (1ll << 31), "a group's moment must fit");
/// Groups and slices that are summed before the base plane is touched: few enough for neighbouring columns to find the
/// voxels' cache lines again.
constexpr int kGroupsAtOnce = 8;
constexpr int kSlicesAtOnce = 16;
static_assert(kSlicesAtOnce >= kMaxGroup, "a group must fit");

/// A group of slices as seen by a block of rows of the base plane.
struct SliceGroup
{
  const SliceView* views;
  int slices;
  const std::int16_t* voxels;  ///< of the first slice, the first voxel row that the block needs
  int voxel_rows;              ///< that it needs
  int first_column;            ///< base columns that values other than zero reach: a multiple of kLanes
  int last_column;
  int offset[kBaseRowsPerCall];  ///< of the voxel row below, in floats, in the sums
  float low[kBaseRowsPerCall];   ///< weight of the voxel row below
  float high[kBaseRowsPerCall];  ///< and of the one above
};

/// A group's sums over slices at kLanes base columns, voxel row by voxel row, times kOne.
struct GroupSums
{
  alignas(64) float sum[kVoxelRowsPerCall * kLanes];
  alignas(64) float moment[kVoxelRowsPerCall * kLanes];
};

/// Base columns that the group's values other than zero in some voxel rows reach.
inline void findColumns(const SliceStack& stack, int first_slice, int first_row, int last_row, const BasePlane& base,
                        SliceGroup& group)
{
  const float last_base_column = static_cast<float>(base.columns - 1);
  float first = last_base_column + 1.0f;
  float last = -1.0f;
  for (int n = 0; n < group.slices; ++n)
  {
    const RowExtent* extents = stack.extents + static_cast<std::ptrdiff_t>(first_slice + n) * stack.extents_per_slice;
    int first_voxel = 32767;
    int last_voxel = -1;
    for (int block = first_row / kRowsPerExtent; block <= last_row / kRowsPerExtent; ++block)
    {
      first_voxel = extents[block].first < first_voxel ? extents[block].first : first_voxel;
      last_voxel = extents[block].last > last_voxel ? extents[block].last : last_voxel;
    }
    if (first_voxel <= last_voxel)
    {
      const SliceView& view = group.views[n];
      const float inverse_step = 1.0f / view.column_step;
      const float from = (static_cast<float>(first_voxel - 1) - view.column_at_zero) * inverse_step;
      const float to = (static_cast<float>(last_voxel + 1) - view.column_at_zero) * inverse_step;
      first = from < first ? from : first;
      last = to > last ? to : last;
    }
  }
  group.first_column = static_cast<int>(clampFloat(first, 0.0f, last_base_column + 1.0f)) / kLanes * kLanes;
  group.last_column = static_cast<int>(clampFloat(last, -1.0f, last_base_column));
}

/// @return false if the rows see nothing of the slices
inline bool viewGroup(const SliceStack& stack, int first, int count, const BasePlane& base, int base_row, int row_count,
                      SliceGroup& group)
{
  const SliceView& front = stack.views[first];
  const SliceView& back = stack.views[first + count - 1];
  const float row_step = 0.5f * (front.row_step + back.row_step);
  const float at_first = 0.5f * (front.row_at_zero + back.row_at_zero) + row_step * static_cast<float>(base_row);
  const float at_last = at_first + row_step * static_cast<float>(row_count - 1);
  const float lowest = -1.0f;
  const float highest = static_cast<float>(stack.rows);
  if (!(at_last > lowest) || !(at_first < highest))
  {
    return false;
  }
  // All of a call's rows are inside.
  const int last_first_row = stack.rows > kVoxelRowsPerCall ? stack.rows - kVoxelRowsPerCall : 0;
  const int first_row = clampInt(floorToInt(clampFloat(at_first, lowest, highest)), 0, last_first_row);
  const int last_row = clampInt(floorToInt(clampFloat(at_last, lowest, highest)) + 1, 0, stack.rows - 1);
  group.views = &front;
  group.slices = count;
  group.voxels = stack.voxels + first * stack.slice_stride + first_row * stack.row_stride;
  group.voxel_rows = last_row - first_row + 1;
  findColumns(stack, first, first_row, last_row, base, group);
  if (group.last_column < group.first_column)
  {
    return false;
  }
  const int last_below = group.voxel_rows > 2 ? group.voxel_rows - 2 : 0;
  for (int q = 0; q < row_count; ++q)
  {
    const float at = at_first + row_step * static_cast<float>(q) - static_cast<float>(first_row);
    const int below = clampInt(floorToInt(clampFloat(at, lowest, kVoxelRowsPerCall)), 0, last_below);
    const float share = at - static_cast<float>(below);
    group.offset[q] = below * kLanes;
    group.low[q] = hat(share) * (1.0f / kOne);
    group.high[q] = hat(share - 1.0f) * (1.0f / kOne);
  }
  return true;
}

/// Voxels ahead: a block reads more rows at once than the processor foresees by itself.
constexpr int kPrefetch = 32;

template <bool with_moment>
inline void sumGroup(const SliceStack& stack, const SliceGroup& group, int column, GroupSums& sums)
{
  constexpr int kRowsAtOnce = with_moment && kLanes < 16 ? 4 : 8;  // as many as the sums' registers suffice for
  static_assert(kVoxelRowsPerCall % kRowsAtOnce == 0, "rows are taken in whole blocks");
  const std::int16_t* voxels[kMaxGroup];
  Lookup lookups[kMaxGroup];
  for (int n = 0; n < group.slices; ++n)
  {
    const SliceView& view = group.views[n];
    // Beyond these everything is zero.
    const float at = clampFloat(view.column_at_zero + view.column_step * static_cast<float>(column), -kMargin,
                                static_cast<float>(stack.columns));
    const int start = floorToInt(at);
    voxels[n] = group.voxels + n * stack.slice_stride + start;
    lookups[n] = makeLookup(at - static_cast<float>(start), view.column_step);
  }
  for (int first = 0; first < group.voxel_rows; first += kRowsAtOnce)
  {
    Ints sum[kRowsAtOnce] = {};
    Ints sum_of_sums[kRowsAtOnce] = {};  // counts a slice as often as one comes after it, and once for itself
    for (int n = 0; n < group.slices; ++n)
    {
      const std::int16_t* row = voxels[n] + first * stack.row_stride;
      const Lookup lookup = lookups[n];
#pragma GCC unroll 16
      for (int q = 0; q < kRowsAtOnce; ++q)
      {
        __builtin_prefetch(row + kPrefetch, 0, 2);  // not into the first level, which it would sweep
        sum[q] += interpolate(row, lookup);
        if (with_moment)
        {
          sum_of_sums[q] += sum[q];
        }
        row += stack.row_stride;
      }
    }
    const float weight = group.views[0].moment_weight;
    const float weight_step =
        (group.views[group.slices - 1].moment_weight - weight) / (group.slices > 1 ? group.slices - 1 : 1);
#pragma GCC unroll 16
    for (int q = 0; q < kRowsAtOnce; ++q)
    {
      store(sums.sum + (first + q) * kLanes, toFloats(sum[q]));
      if (with_moment)
      {
        store(sums.moment + (first + q) * kLanes,
              (weight + weight_step * static_cast<float>(group.slices)) * toFloats(sum[q]) -
                  weight_step * toFloats(sum_of_sums[q]));
      }
    }
  }
}

/// Adds the groups' sums, interpolated along the rows, to kLanes columns of the base plane.
template <bool with_moment>
inline void accumulateColumns(const SliceStack& stack, const SliceGroup* groups, int group_count, const BasePlane& base,
                              int base_row, int row_count, int column)
{
  const SliceGroup* seen[kGroupsAtOnce];
  GroupSums sums[kGroupsAtOnce];
  int count = 0;
  for (int n = 0; n < group_count; ++n)
  {
    if (column >= groups[n].first_column && column <= groups[n].last_column)
    {
      sumGroup<with_moment>(stack, groups[n], column, sums[count]);
      seen[count++] = &groups[n];
    }
  }
  std::ptrdiff_t offset = static_cast<std::ptrdiff_t>(base_row) * base.columns + column;
  for (int q = 0; q < row_count; ++q, offset += base.columns)
  {
    Floats sum = load<Floats>(base.sum + offset);
    Floats moment = {};
    for (int n = 0; n < count; ++n)
    {
      const float low = seen[n]->low[q];
      const float high = seen[n]->high[q];
      const float* below = sums[n].sum + seen[n]->offset[q];
      sum += low * load<Floats>(below);
      sum += high * load<Floats>(below + kLanes);
      if (with_moment)
      {
        const float* moment_below = sums[n].moment + seen[n]->offset[q];
        moment += low * load<Floats>(moment_below);
        moment += high * load<Floats>(moment_below + kLanes);
      }
    }
    store(base.sum + offset, sum);
    if (with_moment)
    {
      store(base.moment + offset, load<Floats>(base.moment + offset) + moment);
    }
  }
}

/// Slices whose rows drift by no more than kMaxDrift.
inline int groupSize(const SliceStack& stack, bool with_moment, int base_row, int row_count)
{
  // The drift is the same from every slice to the next, and linear in the row.
  const SliceView& first = stack.views[0];
  const SliceView& last = stack.views[stack.slices - 1];
  const auto drift_of = [&](int row)
  { return __builtin_fabsf(last.row_at_zero - first.row_at_zero + (last.row_step - first.row_step) * row); };
  const float at_first = drift_of(base_row);
  const float at_last = drift_of(base_row + row_count - 1);
  const float drift = at_first > at_last ? at_first : at_last;
  const float slices = 1.0f + kMaxDrift * static_cast<float>(stack.slices - 1) / drift;
  const int most = with_moment ? kMaxMomentGroup : kMaxGroup;
  return slices < most ? static_cast<int>(slices) : most;
}

void accumulate(const SliceStack& stack, const BasePlane& base, int base_row, int row_count)
{
  const std::size_t bytes = sizeof(float) * row_count * base.columns;
  __builtin_memset(base.sum + static_cast<std::ptrdiff_t>(base_row) * base.columns, 0, bytes);
  if (base.moment)
  {
    __builtin_memset(base.moment + static_cast<std::ptrdiff_t>(base_row) * base.columns, 0, bytes);
  }
  const int group_size = groupSize(stack, base.moment, base_row, row_count);
  SliceGroup groups[kGroupsAtOnce];
  for (int slice = 0; slice < stack.slices;)
  {
    int count = 0;
    int first_column = base.columns;
    int last_column = -1;
    const int end =
        slice + kSlicesAtOnce < stack.slices ? slice + kSlicesAtOnce / group_size * group_size : stack.slices;
    for (; slice < end && count < kGroupsAtOnce; slice += group_size)
    {
      SliceGroup& group = groups[count];
      const int size = stack.slices - slice < group_size ? stack.slices - slice : group_size;
      if (viewGroup(stack, slice, size, base, base_row, row_count, group))
      {
        first_column = group.first_column < first_column ? group.first_column : first_column;
        last_column = group.last_column > last_column ? group.last_column : last_column;
        ++count;
      }
    }
    for (int column = first_column; column <= last_column; column += kLanes)
    {
      if (base.moment)
      {
        accumulateColumns<true>(stack, groups, count, base, base_row, row_count, column);
      }
      else
      {
        accumulateColumns<false>(stack, groups, count, base, base_row, row_count, column);
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
