#include "kernels.h"

#include <algorithm>
#include <cmath>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(XRAY_TRACKING_PLAIN_KERNELS)
#include <immintrin.h>
#define XRAY_TRACKING_AVX2 __attribute__((target("avx2,fma")))
#endif

namespace xray_tracking
{
namespace
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

void samplePlain(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                 std::ptrdiff_t begin, std::ptrdiff_t end, const PixelMap& m, float* values)
{
  for (std::ptrdiff_t i = begin; i < end; ++i)
  {
    const Place at = placeOf(m, x[i], y[i]);
    const std::uint16_t* p = pixels + static_cast<std::size_t>(at.top) * row_length + at.left;
    const float upper = p[0] + at.u * static_cast<float>(p[1] - p[0]);
    const float lower = p[row_length] + at.u * static_cast<float>(p[row_length + 1] - p[row_length]);
    values[i] = upper + at.v * (lower - upper);
  }
}

void sampleSplinePlain(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                       std::ptrdiff_t begin, std::ptrdiff_t end, const PixelMap& m, float* values)
{
  for (std::ptrdiff_t i = begin; i < end; ++i)
  {
    const Place at = placeOf(m, x[i], y[i]);
    float along_x[4], along_y[4];
    splineWeights(at.u, along_x);
    splineWeights(at.v, along_y);
    const std::uint16_t* p = pixels + static_cast<std::size_t>(at.top - 1) * row_length + (at.left - 1);
    float sum = 0.f;
    for (int r = 0; r < 4; ++r, p += row_length)
    {
      sum += along_y[r] * (along_x[0] * p[0] + along_x[1] * p[1] + along_x[2] * p[2] + along_x[3] * p[3]);
    }
    values[i] = sum;
  }
}

void attenuatePlain(float* values, std::ptrdiff_t begin, std::ptrdiff_t end, float offset)
{
  for (std::ptrdiff_t i = begin; i < end; ++i)
  {
    values[i] = -std::log(std::max(values[i] - offset, 1.f));
  }
}

float dotPlain(const float* a, const float* b, std::ptrdiff_t begin, std::ptrdiff_t end)
{
  float sum = 0.f;
  for (std::ptrdiff_t i = begin; i < end; ++i)
  {
    sum += a[i] * b[i];
  }
  return sum;
}

#ifdef XRAY_TRACKING_AVX2
const bool kHasAvx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");

/// Where eight points are: the pixel's index and the parts of a pixel beyond it.
struct VectorPlaces
{
  __m256i pixel;
  __m256 u, v;
};

class VectorMap
{
public:
  XRAY_TRACKING_AVX2 VectorMap(const PixelMap& m, std::size_t row_length)
    : xx_(_mm256_set1_ps(m.xx)),
      xy_(_mm256_set1_ps(m.xy)),
      x0_(_mm256_set1_ps(m.x0)),
      yx_(_mm256_set1_ps(m.yx)),
      yy_(_mm256_set1_ps(m.yy)),
      y0_(_mm256_set1_ps(m.y0)),
      stride_(_mm256_set1_epi32(static_cast<int>(row_length)))
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
    return { _mm256_add_epi32(_mm256_mullo_epi32(top, stride_), left), _mm256_sub_ps(column, _mm256_cvtepi32_ps(left)),
             _mm256_sub_ps(row, _mm256_cvtepi32_ps(top)) };
  }

private:
  __m256 xx_, xy_, x0_, yx_, yy_, y0_;
  __m256i stride_;
};

XRAY_TRACKING_AVX2 std::ptrdiff_t sampleAvx2(const std::uint16_t* pixels, std::size_t row_length, const float* x,
                                             const float* y, std::ptrdiff_t count, const PixelMap& m, float* values)
{
  const VectorMap map(m, row_length);
  const __m256i low = _mm256_set1_epi32(0xffff);
  const int* upper_row = reinterpret_cast<const int*>(pixels);
  const int* lower_row = reinterpret_cast<const int*>(pixels + row_length);
  std::ptrdiff_t i = 0;
  for (; i + 8 <= count; i += 8)
  {
    const VectorPlaces at = map.places(x + i, y + i);
    // A load of 32 bit has a pixel and its right neighbour.
    const __m256i a = _mm256_i32gather_epi32(upper_row, at.pixel, 2);
    const __m256i b = _mm256_i32gather_epi32(lower_row, at.pixel, 2);
    const __m256 a0 = _mm256_cvtepi32_ps(_mm256_and_si256(a, low));
    const __m256 a1 = _mm256_cvtepi32_ps(_mm256_srli_epi32(a, 16));
    const __m256 b0 = _mm256_cvtepi32_ps(_mm256_and_si256(b, low));
    const __m256 b1 = _mm256_cvtepi32_ps(_mm256_srli_epi32(b, 16));
    const __m256 upper = _mm256_fmadd_ps(at.u, _mm256_sub_ps(a1, a0), a0);
    const __m256 lower = _mm256_fmadd_ps(at.u, _mm256_sub_ps(b1, b0), b0);
    _mm256_storeu_ps(values + i, _mm256_fmadd_ps(at.v, _mm256_sub_ps(lower, upper), upper));
  }
  return i;
}

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

/// Four pixels of one row for each of two points.
XRAY_TRACKING_AVX2 inline __m256 pixelsOfTwo(const std::uint16_t* low, const std::uint16_t* high)
{
  const __m128i first = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(low));
  const __m128i both = _mm_unpacklo_epi64(first, _mm_loadl_epi64(reinterpret_cast<const __m128i*>(high)));
  return _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(both));
}

/// What the points k and k + 4 see: four columns each, summed along y.
template <int k>
XRAY_TRACKING_AVX2 inline __m256 columnsOfTwo(const std::uint16_t* pixels, std::size_t row_length,
                                              const std::int32_t* places, const SplineVectors& along_y)
{
  const std::uint16_t* low = pixels + places[k];
  const std::uint16_t* high = pixels + places[k + 4];
  __m256 sum = _mm256_setzero_ps();
  for (int r = 0; r < 4; ++r, low += row_length, high += row_length)
  {
    sum = _mm256_fmadd_ps(_mm256_permute_ps(along_y.weights[r], k * 0x55), pixelsOfTwo(low, high), sum);
  }
  return sum;
}

XRAY_TRACKING_AVX2 std::ptrdiff_t sampleSplineAvx2(const std::uint16_t* pixels, std::size_t row_length, const float* x,
                                                   const float* y, std::ptrdiff_t count, const PixelMap& m,
                                                   float* values)
{
  const VectorMap map(m, row_length);
  const std::uint16_t* first = pixels - row_length - 1;
  std::ptrdiff_t i = 0;
  for (; i + 8 <= count; i += 8)
  {
    const VectorPlaces at = map.places(x + i, y + i);
    const SplineVectors along_x = splineVectors(at.u);
    const SplineVectors along_y = splineVectors(at.v);
    alignas(32) std::int32_t places[8];
    _mm256_store_si256(reinterpret_cast<__m256i*>(places), at.pixel);
    // From weights of eight points, one vector a column, to those of four columns, one vector two points.
    const __m256 a = _mm256_unpacklo_ps(along_x.weights[0], along_x.weights[1]);
    const __m256 b = _mm256_unpackhi_ps(along_x.weights[0], along_x.weights[1]);
    const __m256 c = _mm256_unpacklo_ps(along_x.weights[2], along_x.weights[3]);
    const __m256 d = _mm256_unpackhi_ps(along_x.weights[2], along_x.weights[3]);
    const __m256 s0 = _mm256_mul_ps(_mm256_shuffle_ps(a, c, 0x44), columnsOfTwo<0>(first, row_length, places, along_y));
    const __m256 s1 = _mm256_mul_ps(_mm256_shuffle_ps(a, c, 0xee), columnsOfTwo<1>(first, row_length, places, along_y));
    const __m256 s2 = _mm256_mul_ps(_mm256_shuffle_ps(b, d, 0x44), columnsOfTwo<2>(first, row_length, places, along_y));
    const __m256 s3 = _mm256_mul_ps(_mm256_shuffle_ps(b, d, 0xee), columnsOfTwo<3>(first, row_length, places, along_y));
    _mm256_storeu_ps(values + i, _mm256_hadd_ps(_mm256_hadd_ps(s0, s1), _mm256_hadd_ps(s2, s3)));
  }
  return i;
}

XRAY_TRACKING_AVX2 std::ptrdiff_t attenuateAvx2(float* values, std::ptrdiff_t count, float offset)
{
  const __m256 one = _mm256_set1_ps(1.f);
  std::ptrdiff_t i = 0;
  for (; i + 8 <= count; i += 8)
  {
    const __m256 v = _mm256_max_ps(_mm256_sub_ps(_mm256_loadu_ps(values + i), _mm256_set1_ps(offset)), one);
    // v = 2^e m with m in sqrt(1/2) .. sqrt(2); log m = 2 artanh(s), s = (m - 1) / (m + 1), |s| < 0.172
    const __m256i bits = _mm256_sub_epi32(_mm256_castps_si256(v), _mm256_set1_epi32(0x3f3504f3));
    const __m256 e = _mm256_cvtepi32_ps(_mm256_srai_epi32(bits, 23));
    const __m256 m = _mm256_castsi256_ps(
        _mm256_add_epi32(_mm256_and_si256(bits, _mm256_set1_epi32(0x7fffff)), _mm256_set1_epi32(0x3f3504f3)));
    const __m256 s = _mm256_div_ps(_mm256_sub_ps(m, one), _mm256_add_ps(m, one));
    const __m256 q = _mm256_mul_ps(s, s);
    __m256 series = _mm256_fmadd_ps(q, _mm256_set1_ps(2.f / 7.f), _mm256_set1_ps(2.f / 5.f));
    series = _mm256_fmadd_ps(q, series, _mm256_set1_ps(2.f / 3.f));
    series = _mm256_fmadd_ps(q, series, _mm256_set1_ps(2.f));
    const __m256 log = _mm256_fmadd_ps(e, _mm256_set1_ps(0.69314718056f), _mm256_mul_ps(s, series));
    _mm256_storeu_ps(values + i, _mm256_sub_ps(_mm256_setzero_ps(), log));
  }
  return i;
}

XRAY_TRACKING_AVX2 float dotAvx2(const float* a, const float* b, std::ptrdiff_t count)
{
  __m256 sums[4] = { _mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps() };
  std::ptrdiff_t i = 0;
  for (; i + 32 <= count; i += 32)
  {
    for (int k = 0; k < 4; ++k)
    {
      sums[k] = _mm256_fmadd_ps(_mm256_loadu_ps(a + i + 8 * k), _mm256_loadu_ps(b + i + 8 * k), sums[k]);
    }
  }
  for (; i + 8 <= count; i += 8)
  {
    sums[0] = _mm256_fmadd_ps(_mm256_loadu_ps(a + i), _mm256_loadu_ps(b + i), sums[0]);
  }
  float parts[8];
  _mm256_storeu_ps(parts, _mm256_add_ps(_mm256_add_ps(sums[0], sums[1]), _mm256_add_ps(sums[2], sums[3])));
  float sum = dotPlain(a, b, i, count);
  for (const float part : parts)
  {
    sum += part;
  }
  return sum;
}

/// Four columns at once, which load what they are multiplied by once; whole vectors of them.
XRAY_TRACKING_AVX2 __m128 fourDotsAvx2(const float* columns, const float* b, std::ptrdiff_t count)
{
  __m256 sums[4] = { _mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps() };
  for (std::ptrdiff_t i = 0; i + 8 <= count; i += 8)
  {
    const __m256 values = _mm256_loadu_ps(b + i);
    for (int k = 0; k < 4; ++k)
    {
      sums[k] = _mm256_fmadd_ps(_mm256_loadu_ps(columns + k * count + i), values, sums[k]);
    }
  }
  const __m256 pairs = _mm256_hadd_ps(_mm256_hadd_ps(sums[0], sums[1]), _mm256_hadd_ps(sums[2], sums[3]));
  return _mm_add_ps(_mm256_castps256_ps128(pairs), _mm256_extractf128_ps(pairs, 1));
}

XRAY_TRACKING_AVX2 std::ptrdiff_t dotsAvx2(const float* columns, std::ptrdiff_t number, const float* b,
                                           std::ptrdiff_t count, float* sums)
{
  std::ptrdiff_t k = 0;
  for (; count % 8 == 0 && k + 4 <= number; k += 4)
  {
    _mm_storeu_ps(sums + k, fourDotsAvx2(columns + k * count, b, count));
  }
  return k;
}
#endif
}  // namespace

void sampleBilinear(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                    std::ptrdiff_t count, const PixelMap& map, float* values)
{
  std::ptrdiff_t done = 0;
#ifdef XRAY_TRACKING_AVX2
  done = kHasAvx2 ? sampleAvx2(pixels, row_length, x, y, count, map, values) : 0;
#endif
  samplePlain(pixels, row_length, x, y, done, count, map, values);
}

void sampleSpline(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                  std::ptrdiff_t count, const PixelMap& map, float* values)
{
  std::ptrdiff_t done = 0;
#ifdef XRAY_TRACKING_AVX2
  done = kHasAvx2 ? sampleSplineAvx2(pixels, row_length, x, y, count, map, values) : 0;
#endif
  sampleSplinePlain(pixels, row_length, x, y, done, count, map, values);
}

void splineWeights(float part, float* weights)
{
  const float rest = 1.f - part;
  weights[0] = rest * rest * rest / 6.f;
  weights[1] = 2.f / 3.f + part * part * (0.5f * part - 1.f);
  weights[2] = 2.f / 3.f + rest * rest * (0.5f * rest - 1.f);
  weights[3] = part * part * part / 6.f;
}

void attenuate(float* values, std::ptrdiff_t count, float offset)
{
  std::ptrdiff_t done = 0;
#ifdef XRAY_TRACKING_AVX2
  if (kHasAvx2)
  {
    done = attenuateAvx2(values, count, offset);
  }
#endif
  attenuatePlain(values, done, count, offset);
}

float dot(const float* a, const float* b, std::ptrdiff_t count)
{
#ifdef XRAY_TRACKING_AVX2
  if (kHasAvx2)
  {
    return dotAvx2(a, b, count);
  }
#endif
  return dotPlain(a, b, 0, count);
}

void dots(const float* columns, std::ptrdiff_t number, const float* b, std::ptrdiff_t count, float* sums)
{
  std::ptrdiff_t done = 0;
#ifdef XRAY_TRACKING_AVX2
  done = kHasAvx2 ? dotsAvx2(columns, number, b, count, sums) : 0;
#endif
  for (; done < number; ++done)
  {
    sums[done] = dot(columns + done * count, b, count);
  }
}
}  // namespace xray_tracking
