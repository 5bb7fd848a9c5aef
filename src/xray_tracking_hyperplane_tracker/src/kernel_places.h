// Where points are in an image, for the files that sample it.
#pragma once

#include "kernels.h"

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#define XRAY_TRACKING_AVX2 __attribute__((target("avx2,fma")))
#endif

namespace xray_tracking
{
/// Where a point is: the pixel and the parts of a pixel beyond it.
struct Place
{
  int left, top;
  float u, v;
};

inline Place placeOf(const PixelMap& m, float x, float y)
{
  const float column = m.xx * x + (m.xy * y + m.x0);
  const float row = m.yx * x + (m.yy * y + m.y0);
  const int left = static_cast<int>(column);
  const int top = static_cast<int>(row);
  return { left, top, column - static_cast<float>(left), row - static_cast<float>(top) };
}

#ifdef XRAY_TRACKING_AVX2
inline const bool kHasAvx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");

/// Where eight points are: the pixel and the parts of a pixel beyond it.
struct VectorPlaces
{
  __m256i left, top;
  __m256 u, v;
};

class VectorMap
{
public:
  explicit XRAY_TRACKING_AVX2 VectorMap(const PixelMap& m)
    : xx_(_mm256_set1_ps(m.xx)),
      xy_(_mm256_set1_ps(m.xy)),
      x0_(_mm256_set1_ps(m.x0)),
      yx_(_mm256_set1_ps(m.yx)),
      yy_(_mm256_set1_ps(m.yy)),
      y0_(_mm256_set1_ps(m.y0))
  {
  }
  XRAY_TRACKING_AVX2 VectorPlaces places(const float* x, const float* y) const
  {
    const __m256 px = _mm256_loadu_ps(x);
    const __m256 py = _mm256_loadu_ps(y);
    const __m256 column = _mm256_fmadd_ps(xx_, px, _mm256_fmadd_ps(xy_, py, x0_));
    const __m256 row = _mm256_fmadd_ps(yx_, px, _mm256_fmadd_ps(yy_, py, y0_));
    const __m256i left = _mm256_cvttps_epi32(column);
    const __m256i top = _mm256_cvttps_epi32(row);
    return { left, top, _mm256_sub_ps(column, _mm256_cvtepi32_ps(left)), _mm256_sub_ps(row, _mm256_cvtepi32_ps(top)) };
  }

private:
  __m256 xx_, xy_, x0_, yx_, yy_, y0_;
};

#endif
}  // namespace xray_tracking
