// The kernels for one processor: included by a translation unit each, which defines `kKernels`'s name as
// SHEAR_WARP_KERNELS and is compiled with that processor's options. See shear_warp_kernel.h for what may not be used.

#include "shear_warp_kernel.h"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace xray_tracking
{
namespace shear_warp
{
namespace
{
#if defined(__AVX512F__)
constexpr int kLanes = 16;
constexpr int kAccumulators = 16;
#else
constexpr int kLanes = 8;
constexpr int kAccumulators = 8;
#endif

using Float4 = float __attribute__((vector_size(16)));
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));
using Shorts = std::int16_t __attribute__((vector_size(2 * kLanes)));

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

inline Floats loadVoxels(const std::int16_t* voxels)
{
#if defined(__AVX512F__)
  return _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(voxels))));
#elif defined(__AVX2__)
  return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(voxels))));
#else
  return toFloats(__builtin_convertvector(load<Shorts>(voxels), Ints));
#endif
}

/// values[indices modulo kLanes]
inline Floats permute(Floats values, Ints indices)
{
#if defined(__AVX512F__)
  return _mm512_permutexvar_ps(reinterpret_cast<__m512i>(indices), values);
#elif defined(__AVX2__)
  return _mm256_permutevar8x32_ps(values, reinterpret_cast<__m256i>(indices));
#else
  Floats permuted;
  for (int lane = 0; lane < kLanes; ++lane)
  {
    permuted[lane] = values[indices[lane] & (kLanes - 1)];
  }
  return permuted;
#endif
}

inline Floats laneNumbers()
{
  Floats numbers;
  for (int lane = 0; lane < kLanes; ++lane)
  {
    numbers[lane] = static_cast<float>(lane);
  }
  return numbers;
}

/// `value` where `indices` is a lane's number, 0 elsewhere
inline Floats whereLane(Ints indices, Floats value)
{
  const Ints inside = (indices >= 0) & (indices < kLanes);
  return reinterpret_cast<Floats>(reinterpret_cast<Ints>(value) & inside);
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

#include "shear_warp_accumulate.inl"
#include "shear_warp_warp.inl"
}  // namespace

const Kernels SHEAR_WARP_KERNELS = { accumulate, filter, warp, warpWithDerivatives };
}  // namespace shear_warp
}  // namespace xray_tracking
