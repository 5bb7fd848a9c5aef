#pragma once

#include <cstdint>

namespace xray_tracking
{
/// Random numbers by counter (SplitMix64: Steele, Lea, Flood, OOPSLA 2014): a number depends only on the seed, on the
/// chain of part() that names its use, and on its index; not on threads or on the order of calls.
class RandomStream
{
public:
  explicit RandomStream(std::uint64_t seed) : key_(seed) {}

  /// The independent stream of a part, e.g. of a detector, an exposure or a row.
  RandomStream part(std::uint64_t index) const;

  std::uint64_t bits(std::uint64_t index) const;
  /// Uniform in [0, 1).
  double uniform(std::uint64_t index) const;

  /// Independent standard normal numbers (Box and Muller; 24 random bits, so that |z| <= 5.8).
  /// @param out `count` numbers, which may differ for another count
  void fillNormal(float* out, int count) const;

private:
  std::uint64_t key_;
};

/// A Poisson variate made from one standard normal number, so that a pixel needs only one. Below a mean of 16 by exact
/// inversion of the distribution function; above by the Cornish-Fisher expansion
/// mean + sqrt(mean) z + (z^2 - 1) / 6, not rounded: mean exact, variance too large by 1/18, skewness to first order.
/// @param mean >= 0
float poissonFromNormal(float mean, float z);
}  // namespace xray_tracking
