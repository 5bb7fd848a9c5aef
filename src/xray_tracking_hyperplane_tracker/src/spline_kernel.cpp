#include <algorithm>
#include <cmath>

#include "kernel_places.h"
#include "kernels.h"

namespace xray_tracking
{
namespace
{
/// How a map moves the points of a group against each other, beyond their distance.
struct Drift
{
  explicit Drift(const PixelMap& m, int step)
    : x((m.xx - 1.f) * static_cast<float>(step)), y(m.yx * static_cast<float>(step))
  {
  }
  float x, y;  ///< from one point to the next [px]
};

void sampleSplinePlain(const SplineSource& s, const float* x, const float* y, std::ptrdiff_t begin, std::ptrdiff_t end,
                       const PixelMap& m, float* values)
{
  const Drift drift(m, s.step);
  for (std::ptrdiff_t g = begin; g < end; ++g)
  {
    const Place first = placeOf(m, x[g], y[g]);
    for (int k = 0; k < kGroup; ++k)
    {
      const float u = first.u + drift.x * static_cast<float>(k), v = first.v + drift.y * static_cast<float>(k);
      const float left = std::floor(u), top = std::floor(v);
      float along_x[4], along_y[4];
      splineWeights(u - left, along_x);
      splineWeights(v - top, along_y);
      float sum = 0.f;
      const std::int32_t* column = s.column + first.left + static_cast<int>(left) - 1;
      const float* row = s.values + (first.top + static_cast<int>(top) - 1) * s.row + k;
      for (int c = 0; c < 4; ++c)
      {
        const float* p = row + column[c];
        sum += along_x[c] *
               (along_y[0] * p[0] + along_y[1] * p[s.row] + along_y[2] * p[2 * s.row] + along_y[3] * p[3 * s.row]);
      }
      values[g * kGroup + k] = sum;
    }
  }
}

#ifdef XRAY_TRACKING_AVX2
struct SplineVectors
{
  __m256 weights[4];
};

XRAY_TRACKING_AVX2 inline SplineVectors splineVectors(__m256 t)
{
  const __m256 sixth = _mm256_set1_ps(1.f / 6.f), two_thirds = _mm256_set1_ps(2.f / 3.f), half = _mm256_set1_ps(0.5f);
  const __m256 one = _mm256_set1_ps(1.f);
  const __m256 u = _mm256_sub_ps(one, t);
  const __m256 tt = _mm256_mul_ps(t, t), uu = _mm256_mul_ps(u, u);
  SplineVectors v;
  v.weights[0] = _mm256_mul_ps(sixth, _mm256_mul_ps(uu, u));
  v.weights[1] = _mm256_fmadd_ps(tt, _mm256_fmsub_ps(half, t, one), two_thirds);
  v.weights[2] = _mm256_fmadd_ps(uu, _mm256_fmsub_ps(half, u, one), two_thirds);
  v.weights[3] = _mm256_mul_ps(sixth, _mm256_mul_ps(tt, t));
  return v;
}

/// Weights along an axis of the pixels from one before the first of a group's on, if these are apart.
class GroupWeights
{
public:
  /// @param part of a pixel that the first place is beyond its pixel; @param drift from place to place
  XRAY_TRACKING_AVX2 GroupWeights(float part, float drift)
  {
    const __m256 places = _mm256_fmadd_ps(lanes(), _mm256_set1_ps(drift), _mm256_set1_ps(part));
    const __m256 pixels = _mm256_floor_ps(places);
    // A drift goes one way, so that the last place is the farthest.
    const int last = _mm_cvttss_si32(_mm_permute_ps(_mm256_extractf128_ps(pixels, 1), 3));
    const int apart = std::abs(last);
    first = std::min(last, 0);
    count = 4 + apart;
    if (count > kMost)
    {
      return;
    }
    const SplineVectors own = splineVectors(_mm256_sub_ps(places, pixels));
    if (apart <= 1)
    {
      const __m256 next = _mm256_cmp_ps(pixels, _mm256_set1_ps(static_cast<float>(first)), _CMP_NEQ_UQ);
      weights[0] = _mm256_andnot_ps(next, own.weights[0]);
      for (int i = 1; i < 4; ++i)
      {
        weights[i] = _mm256_blendv_ps(own.weights[i], own.weights[i - 1], next);
      }
      weights[4] = _mm256_and_ps(next, own.weights[3]);
      return;
    }
    for (int i = 0; i < count; ++i)
    {
      weights[i] = _mm256_setzero_ps();
      for (int j = std::max(0, i - apart); j < std::min(4, i + 1); ++j)
      {
        const __m256 there = _mm256_cmp_ps(pixels, _mm256_set1_ps(static_cast<float>(first + i - j)), _CMP_EQ_OQ);
        weights[i] = _mm256_or_ps(weights[i], _mm256_and_ps(there, own.weights[j]));
      }
    }
  }
  static XRAY_TRACKING_AVX2 __m256 lanes() { return _mm256_setr_ps(0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f); }
  bool tooMany() const { return count > kMost; }

  int first;  ///< pixel
  int count;
  static constexpr int kMost = 12;
  __m256 weights[kMost];
};

/// @tparam kRows, kColumns numbers of weights, for loops that the compiler unrolls; 0: any
template <int kRows, int kColumns>
XRAY_TRACKING_AVX2 inline __m256 weighted(const float* row, std::ptrdiff_t stride, const std::int32_t* column,
                                          const GroupWeights& along_x, const GroupWeights& along_y)
{
  const int rows = kRows > 0 ? kRows : along_y.count;
  const int columns = kColumns > 0 ? kColumns : along_x.count;
  __m256 sum = _mm256_setzero_ps();
  for (int c = 0; c < columns; ++c)
  {
    const float* p = row + column[c];
    __m256 of_column = _mm256_setzero_ps();
    for (int r = 0; r < rows; ++r)
    {
      of_column = _mm256_fmadd_ps(along_y.weights[r], _mm256_loadu_ps(p + r * stride), of_column);
    }
    sum = _mm256_fmadd_ps(along_x.weights[c], of_column, sum);
  }
  return sum;
}

/// A group whose points are apart.
XRAY_TRACKING_AVX2 void sampleAnyGroup(const SplineSource& s, float x, float y, const PixelMap& m, const Drift& drift,
                                       float* values)
{
  const Place at = placeOf(m, x, y);
  const GroupWeights along_x(at.u, drift.x), along_y(at.v, drift.y);
  if (along_x.tooMany() || along_y.tooMany())
  {
    sampleSplinePlain(s, &x, &y, 0, 1, m, values);
    return;
  }
  const std::int32_t* column = s.column + at.left + along_x.first - 1;
  const float* row = s.values + (at.top + along_y.first - 1) * s.row;
  const auto sum = along_x.count == 4 && along_y.count <= 5   ? weighted<5, 4>
                   : along_x.count <= 5 && along_y.count <= 5 ? weighted<5, 5>
                                                              : weighted<0, 0>;
  _mm256_storeu_ps(values, sum(row, s.row, column, along_x, along_y));
}

XRAY_TRACKING_AVX2 void sampleSplineAvx2(const SplineSource& s, const float* x, const float* y, std::ptrdiff_t count,
                                         const PixelMap& m, float* values)
{
  constexpr int kAtOnce = 8;  // groups
  const Drift drift(m, s.step);
  const VectorMap map(m);
  const __m256 drift_x = _mm256_mul_ps(GroupWeights::lanes(), _mm256_set1_ps(drift.x));
  const __m256 drift_y = _mm256_mul_ps(GroupWeights::lanes(), _mm256_set1_ps(drift.y));
  const __m256 whole_x = _mm256_set1_ps((kGroup - 1) * drift.x), whole_y = _mm256_set1_ps((kGroup - 1) * drift.y);
  const std::ptrdiff_t row = s.row;
  std::ptrdiff_t g = 0;
  for (; g + kAtOnce <= count; g += kAtOnce)
  {
    const VectorPlaces at = map.places(x + g, y + g);
    alignas(32) std::int32_t left[kAtOnce], top[kAtOnce];
    alignas(32) float u[kAtOnce], v[kAtOnce];
    _mm256_store_si256(reinterpret_cast<__m256i*>(left), at.left);
    _mm256_store_si256(reinterpret_cast<__m256i*>(top), at.top);
    _mm256_store_ps(u, at.u);
    _mm256_store_ps(v, at.v);
    // Of most groups all points are beyond as many pixels as the first one.
    const __m256 apart =
        _mm256_or_ps(_mm256_floor_ps(_mm256_add_ps(at.u, whole_x)), _mm256_floor_ps(_mm256_add_ps(at.v, whole_y)));
    const int are_apart = _mm256_movemask_ps(_mm256_cmp_ps(apart, _mm256_setzero_ps(), _CMP_NEQ_UQ));
    for (int i = 0; i < kAtOnce; ++i)
    {
      float* sampled = values + (g + i) * kGroup;
      if ((are_apart >> i & 1) != 0)
      {
        sampleAnyGroup(s, x[g + i], y[g + i], m, drift, sampled);
        continue;
      }
      const SplineVectors along_x = splineVectors(_mm256_add_ps(_mm256_broadcast_ss(u + i), drift_x));
      const SplineVectors along_y = splineVectors(_mm256_add_ps(_mm256_broadcast_ss(v + i), drift_y));
      const std::int32_t* column = s.column + left[i] - 1;
      const float* first = s.values + (top[i] - 1) * row;
      __m256 sum = _mm256_setzero_ps();
      for (int c = 0; c < 4; ++c)
      {
        const float* p = first + column[c];
        __m256 of_column = _mm256_mul_ps(along_y.weights[0], _mm256_loadu_ps(p));
        of_column = _mm256_fmadd_ps(along_y.weights[1], _mm256_loadu_ps(p + row), of_column);
        of_column = _mm256_fmadd_ps(along_y.weights[2], _mm256_loadu_ps(p + 2 * row), of_column);
        of_column = _mm256_fmadd_ps(along_y.weights[3], _mm256_loadu_ps(p + 3 * row), of_column);
        sum = _mm256_fmadd_ps(along_x.weights[c], of_column, sum);
      }
      _mm256_storeu_ps(sampled, sum);
    }
  }
  for (; g < count; ++g)
  {
    sampleAnyGroup(s, x[g], y[g], m, drift, values + g * kGroup);
  }
}

#endif
}  // namespace

void sampleSpline(const SplineSource& source, const float* x, const float* y, std::ptrdiff_t count, const PixelMap& map,
                  float* values)
{
#ifdef XRAY_TRACKING_AVX2
  if (kHasAvx2)
  {
    sampleSplineAvx2(source, x, y, count, map, values);
    return;
  }
#endif
  sampleSplinePlain(source, x, y, 0, count, map, values);
}

void splineWeights(float part, float* weights)
{
  const float rest = 1.f - part;
  weights[0] = rest * rest * rest / 6.f;
  weights[1] = 2.f / 3.f + part * part * (0.5f * part - 1.f);
  weights[2] = 2.f / 3.f + rest * rest * (0.5f * rest - 1.f);
  weights[3] = part * part * part / 6.f;
}

}  // namespace xray_tracking
