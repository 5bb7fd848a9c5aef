#include "kernels.h"

#include <algorithm>
#include <cmath>

#include "kernel_places.h"

namespace xray_tracking
{
namespace
{
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
XRAY_TRACKING_AVX2 std::ptrdiff_t sampleAvx2(const std::uint16_t* pixels, std::size_t row_length, const float* x,
                                             const float* y, std::ptrdiff_t count, const PixelMap& m, float* values)
{
  const VectorMap map(m);
  const __m256i stride = _mm256_set1_epi32(static_cast<int>(row_length));
  const __m256i low = _mm256_set1_epi32(0xffff);
  const int* upper_row = reinterpret_cast<const int*>(pixels);
  const int* lower_row = reinterpret_cast<const int*>(pixels + row_length);
  std::ptrdiff_t i = 0;
  for (; i + 8 <= count; i += 8)
  {
    const VectorPlaces at = map.places(x + i, y + i);
    const __m256i pixel = _mm256_add_epi32(_mm256_mullo_epi32(at.top, stride), at.left);
    // A load of 32 bit has a pixel and its right neighbour.
    const __m256i a = _mm256_i32gather_epi32(upper_row, pixel, 2);
    const __m256i b = _mm256_i32gather_epi32(lower_row, pixel, 2);
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

XRAY_TRACKING_AVX2 std::ptrdiff_t dotsAvx2(const float* columns, std::ptrdiff_t columns_number, const float* b,
                                           std::ptrdiff_t count, float* sums)
{
  std::ptrdiff_t k = 0;
  for (; count % 8 == 0 && k + 4 <= columns_number; k += 4)
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

void dots(const float* columns, std::ptrdiff_t columns_number, const float* b, std::ptrdiff_t count, float* sums)
{
  std::ptrdiff_t done = 0;
#ifdef XRAY_TRACKING_AVX2
  done = kHasAvx2 ? dotsAvx2(columns, columns_number, b, count, sums) : 0;
#endif
  for (; done < columns_number; ++done)
  {
    sums[done] = dot(columns + done * count, b, count);
  }
}
}  // namespace xray_tracking
