// Samples the base plane at the panel's points; a part of shear_warp_kernel.inl.

// Cubic convolution (Keys, IEEE TASSP 29(6), 1981, a = -1/2): polynomials of the four taps' weights.
constexpr Float4 kCubic0 = { 0.0f, 1.0f, 0.0f, 0.0f };
constexpr Float4 kCubic1 = { -0.5f, 0.0f, 0.5f, 0.0f };
constexpr Float4 kCubic2 = { 1.0f, -2.5f, 2.0f, -0.5f };
constexpr Float4 kCubic3 = { -0.5f, 1.5f, -1.5f, 0.5f };

inline Float4 cubicWeights(float t)
{
  return kCubic0 + t * (kCubic1 + t * (kCubic2 + t * kCubic3));
}
inline Float4 cubicSlopes(float t)
{
  return kCubic1 + t * (2.0f * kCubic2 + t * (3.0f * kCubic3));
}
inline float dot(Float4 a, Float4 b)
{
  const Float4 product = a * b;
  return (product[0] + product[2]) + (product[1] + product[3]);
}

/// The points are taken in blocks: first all positions, which vectorise over points, then all samples, which vectorise
/// over a sample's taps.
constexpr int kBlock = 64;

struct Positions
{
  float column[kBlock];
  float row[kBlock];
  float inverse_w[kBlock];
  float length[kBlock];  ///< that a ray spends between two slices [mm], times the values' scale
};

inline void position(const WarpRow& row, const WarpLimits& limits, int first, int count, Positions& positions)
{
  for (int i = 0; i < count; ++i)
  {
    const float n = static_cast<float>(first + i);
    const float inverse_w = 1.0f / (row.w_0 + n * row.w_n);
    positions.inverse_w[i] = inverse_w;
    positions.column[i] =
        clampFloat((row.column_0 + n * row.column_n) * inverse_w, limits.min_column, limits.max_column);
    positions.row[i] = clampFloat((row.row_0 + n * row.row_n) * inverse_w, limits.min_row, limits.max_row);
    positions.length[i] = __builtin_sqrtf(row.q_0 + n * (row.q_n + n * row.q_nn)) * inverse_w;
  }
}

/// The sixteen taps around a position.
struct Taps
{
  std::ptrdiff_t offset;
  float column_share;
  float row_share;

  Taps(const BasePlane& base, float column, float row)
  {
    const int column_below = static_cast<int>(column);
    const int row_below = static_cast<int>(row);
    offset = static_cast<std::ptrdiff_t>(row_below - 1) * base.columns + (column_below - 1);
    column_share = column - static_cast<float>(column_below);
    row_share = row - static_cast<float>(row_below);
  }
};

/// Weighted sum of four rows of taps.
inline Float4 sumRows(const float* taps, int stride, Float4 weights)
{
  return (weights[0] * load<Float4>(taps) + weights[1] * load<Float4>(taps + stride)) +
         (weights[2] * load<Float4>(taps + 2 * stride) + weights[3] * load<Float4>(taps + 3 * stride));
}

void warp(const BasePlane& base, const WarpLimits& limits, const WarpRow& row)
{
  Positions at;
  for (int first = 0; first < row.count; first += kBlock)
  {
    const int count = row.count - first < kBlock ? row.count - first : kBlock;
    position(row, limits, first, count, at);
    for (int i = 0; i < count; ++i)
    {
      const Taps taps(base, at.column[i], at.row[i]);
      const Float4 column = sumRows(base.sum + taps.offset, base.columns, cubicWeights(taps.row_share));
      row.integrals[first + i] = at.length[i] * dot(column, cubicWeights(taps.column_share));
    }
  }
}

void warpWithDerivatives(const BasePlane& base, const WarpLimits& limits, const WarpRow& row,
                         const WarpDerivatives& derivatives)
{
  Positions at;
  float sum[kBlock], sum_by_column[kBlock], sum_by_row[kBlock], moment_by_column[kBlock], moment_by_row[kBlock];
  for (int first = 0; first < row.count; first += kBlock)
  {
    const int count = row.count - first < kBlock ? row.count - first : kBlock;
    position(row, limits, first, count, at);
    for (int i = 0; i < count; ++i)
    {
      const Taps taps(base, at.column[i], at.row[i]);
      const Float4 row_weights = cubicWeights(taps.row_share);
      const Float4 row_slopes = cubicSlopes(taps.row_share);
      const Float4 column_weights = cubicWeights(taps.column_share);
      const Float4 column_slopes = cubicSlopes(taps.column_share);
      const Float4 sums = sumRows(base.sum + taps.offset, base.columns, row_weights);
      const Float4 moments = sumRows(base.moment + taps.offset, base.columns, row_weights);
      sum[i] = dot(sums, column_weights);
      sum_by_column[i] = dot(sums, column_slopes);
      sum_by_row[i] = dot(sumRows(base.sum + taps.offset, base.columns, row_slopes), column_weights);
      moment_by_column[i] = dot(moments, column_slopes);
      moment_by_row[i] = dot(sumRows(base.moment + taps.offset, base.columns, row_slopes), column_weights);
    }

    const auto& axes = derivatives.index_from_room;
    for (int i = 0; i < count; ++i)
    {
      const float n = static_cast<float>(first + i);
      const float length = at.length[i];
      const float integral = length * sum[i];
      row.integrals[first + i] = integral;

      float ray[3];
      for (int axis = 0; axis < 3; ++axis)
      {
        ray[axis] = derivatives.ray_0[axis] + n * derivatives.ray_n[axis];
      }
      const auto along = [&](int axis)
      { return axes[axis][0] * ray[0] + axes[axis][1] * ray[1] + axes[axis][2] * ray[2]; };
      const float inverse_main = 1.0f / along(2);
      const float column_slope = along(0) * inverse_main;
      const float row_slope = along(1) * inverse_main;

      // Integrals of the gradient across the ray, `whole`, and of its first moment, `tilt`: with s = 1 at the base
      // plane and 0 at the source, `moment` holds slices times 1 - 1 / s, so that its gradient by the base plane's
      // coordinates, which are 1 / s times a slice's, is the integral of (s - 1) * gradient.
      const float column_scale = length * derivatives.points_per_column;
      const float row_scale = length * derivatives.points_per_row;
      const float tilt_column = column_scale * moment_by_column[i];
      const float tilt_row = row_scale * moment_by_row[i];
      const float whole_column = column_scale * sum_by_column[i] - tilt_column;
      const float whole_row = row_scale * sum_by_row[i] - tilt_row;
      const float whole_main = -(column_slope * whole_column + row_slope * whole_row);
      const float tilt_main = -(column_slope * tilt_column + row_slope * tilt_row);
      const float to_base = derivatives.depth * inverse_main;

      float whole[3];
      float lever[3];
      float turn[3];
      for (int axis = 0; axis < 3; ++axis)
      {
        whole[axis] = axes[0][axis] * whole_column + axes[1][axis] * whole_row + axes[2][axis] * whole_main;
        const float tilt = axes[0][axis] * tilt_column + axes[1][axis] * tilt_row + axes[2][axis] * tilt_main;
        // The last term: a turn also changes the length between two slices.
        lever[axis] = to_base * (whole[axis] + tilt) - integral * inverse_main * axes[2][axis];
        turn[axis] = derivatives.from_centre[axis];
      }
      float* output = derivatives.output + static_cast<std::ptrdiff_t>(first + i) * kParameters;
      for (int axis = 0; axis < 3; ++axis)
      {
        const int next = axis == 2 ? 0 : axis + 1;
        const int other = 3 - axis - next;
        output[axis] = -(turn[next] * whole[other] - turn[other] * whole[next] + ray[next] * lever[other] -
                         ray[other] * lever[next]);
        output[3 + axis] = -whole[axis];
      }
    }
  }
}
