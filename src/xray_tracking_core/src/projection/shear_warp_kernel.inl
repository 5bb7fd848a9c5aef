// The kernels for one processor: included by a translation unit each, which defines `kKernels`'s name as
// SHEAR_WARP_KERNELS and is compiled with that processor's options. See shear_warp_kernel.h for what may not be used.

#include "shear_warp_kernel.h"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace xray_tracking
{
namespace shear_warp
{
namespace
{
#if defined(__AVX512BW__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

using Float4 = float __attribute__((vector_size(16)));
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

template <typename Vector, typename Scalar>
inline Vector load(const Scalar* from)
{
  Vector vector;
  __builtin_memcpy(&vector, from, sizeof(vector));
  return vector;
}

template <typename Vector, typename Scalar>
inline void store(Scalar* to, const Vector& vector)
{
  __builtin_memcpy(to, &vector, sizeof(vector));
}

inline Floats toFloats(Ints values)
{
  return __builtin_convertvector(values, Floats);
}

inline Ints laneNumbers()
{
  Ints numbers;
  for (int lane = 0; lane < kLanes; ++lane)
  {
    numbers[lane] = lane;
  }
  return numbers;
}

/// A weight of one as an integer.
constexpr int kOneBits = 11;
constexpr int kOne = 1 << kOneBits;

/// What is interpolated between kLanes voxels at kLanes positions: two neighbours each and their weights, which add up
/// to kOne.
struct Lookup
{
#if defined(__SSE2__)
  Ints pairs;    ///< the neighbours' places, as the processor's permutation takes them
  Ints weights;  ///< 16 bits each
#else
  Ints left;
  Ints left_weight;
  Ints right_weight;
#endif
};

/// @param first position [voxel], 0 to 1; @param step to the next, kMaxStep at most
inline Lookup makeLookup(float first, float step)
{
  constexpr int kFractionBits = 16;
  constexpr float kFraction = 1 << kFractionBits;
  constexpr int kRestBits = kFractionBits - kOneBits;
  const Ints position = static_cast<int>(first * kFraction) + (1 << (kRestBits - 1)) +
                        static_cast<int>(step * kFraction + 0.5f) * laneNumbers();
  const Ints left = position >> kFractionBits;
  const Ints right_weight = (position >> kRestBits) & (kOne - 1);
#if defined(__AVX512BW__)
  return { left * 0x10001 + 0x10000, right_weight * 0xffff + kOne };
#elif defined(__AVX2__)
  return { left * 0x02020202 + 0x03020100, right_weight * 0xffff + kOne };
#elif defined(__SSE2__)
  return { left, right_weight * 0xffff + kOne };
#else
  return { left, kOne - right_weight, right_weight };
#endif
}

/// Times kOne.
inline Ints interpolate(const std::int16_t* voxels, const Lookup& lookup)
{
#if defined(__AVX512BW__)
  const __m512i all = _mm512_castsi256_si512(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(voxels)));
  const __m512i pairs = _mm512_permutexvar_epi16(reinterpret_cast<__m512i>(lookup.pairs), all);
  return reinterpret_cast<Ints>(_mm512_madd_epi16(pairs, reinterpret_cast<__m512i>(lookup.weights)));
#elif defined(__AVX2__)
  const __m256i all = _mm256_broadcastsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(voxels)));
  const __m256i pairs = _mm256_shuffle_epi8(all, reinterpret_cast<__m256i>(lookup.pairs));
  return reinterpret_cast<Ints>(_mm256_madd_epi16(pairs, reinterpret_cast<__m256i>(lookup.weights)));
#elif defined(__SSE2__)
  const auto pair = [&](int lane)
  {
    int both;
    __builtin_memcpy(&both, voxels + lookup.pairs[lane], sizeof(both));
    return both;
  };
  const __m128i pairs = _mm_setr_epi32(pair(0), pair(1), pair(2), pair(3));
  return reinterpret_cast<Ints>(_mm_madd_epi16(pairs, reinterpret_cast<__m128i>(lookup.weights)));
#else
  Ints left;
  Ints right;
  for (int lane = 0; lane < kLanes; ++lane)
  {
    left[lane] = voxels[lookup.left[lane]];
    right[lane] = voxels[lookup.left[lane] + 1];
  }
  return left * lookup.left_weight + right * lookup.right_weight;
#endif
}

inline int floorToInt(float value)
{
  const int truncated = static_cast<int>(value);
  return truncated - (static_cast<float>(truncated) > value);
}

inline int clampInt(int value, int low, int high)
{
  return value < low ? low : value > high ? high : value;
}
inline float clampFloat(float value, float low, float high)
{
  return value < low ? low : value > high ? high : value;
}

/// Weight of linear interpolation at a distance.
inline float hat(float distance)
{
  return clampFloat(1.0f - __builtin_fabsf(distance), 0.0f, 1.0f);
}

#include "shear_warp_accumulate.inl"
#include "shear_warp_warp.inl"
}  // namespace

const Kernels SHEAR_WARP_KERNELS = { accumulate, filter, warp, warpWithDerivatives };
}  // namespace shear_warp
}  // namespace xray_tracking
