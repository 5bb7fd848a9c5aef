#include "xray_tracking_detector_simulator/random_stream.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <opencv2/core.hpp>
#include <opencv2/core/hal/hal.hpp>

namespace xray_tracking
{
namespace
{
constexpr std::uint64_t kGoldenGamma = 0x9e3779b97f4a7c15ULL;
constexpr float kExactPoissonBelow = 16.0F;

std::uint64_t mix(std::uint64_t z)
{
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

float invertPoisson(double mean, double z)
{
  const double probability = 0.5 * std::erfc(-z / std::sqrt(2.0));
  double term = std::exp(-mean);
  double sum = term;
  int k = 0;
  // |z| <= 5.8 ends far below the bound, which only guards against rounding of the sum.
  while (probability > sum && k < 100)
  {
    ++k;
    term *= mean / k;
    sum += term;
  }
  return static_cast<float>(k);
}
}  // namespace

RandomStream RandomStream::part(std::uint64_t index) const
{
  // The second mixing keeps a part's key off the numbers that bits() gives.
  return RandomStream(mix(mix(key_ + (index + 1) * kGoldenGamma) ^ kGoldenGamma));
}

std::uint64_t RandomStream::bits(std::uint64_t index) const
{
  return mix(key_ + (index + 1) * kGoldenGamma);
}

double RandomStream::uniform(std::uint64_t index) const
{
  return static_cast<double>(bits(index) >> 11) * 0x1.0p-53;
}

void RandomStream::fillNormal(float* out, int count) const
{
  constexpr int kPairs = 256;
  std::array<float, kPairs> radius;
  std::array<float, kPairs> angle;
  std::array<float, kPairs> cosine;
  std::array<float, kPairs> sine;
  for (int first = 0; first < count; first += 2 * kPairs)
  {
    const int block = std::min(2 * kPairs, count - first);
    const int pairs = (block + 1) / 2;
    for (int i = 0; i < pairs; ++i)
    {
      const std::uint64_t random = bits(static_cast<std::uint64_t>(first / 2 + i));
      radius[i] = static_cast<float>((random >> 40) + 1) * 0x1.0p-24F;
      angle[i] = static_cast<float>((random >> 8) & 0xffffff) * static_cast<float>(2.0 * CV_PI * 0x1.0p-24);
    }
    cv::hal::log32f(radius.data(), radius.data(), pairs);
    for (int i = 0; i < pairs; ++i)
    {
      radius[i] *= -2.0F;
    }
    cv::hal::sqrt32f(radius.data(), radius.data(), pairs);
    cv::Mat x(1, pairs, CV_32F, cosine.data());
    cv::Mat y(1, pairs, CV_32F, sine.data());
    cv::polarToCart(cv::Mat(1, pairs, CV_32F, radius.data()), cv::Mat(1, pairs, CV_32F, angle.data()), x, y);
    std::copy_n(cosine.data(), pairs, out + first);
    std::copy_n(sine.data(), block - pairs, out + first + pairs);
  }
}

float poissonFromNormal(float mean, float z)
{
  if (mean < kExactPoissonBelow)
  {
    return invertPoisson(mean, z);
  }
  return std::max(0.0F, mean + std::sqrt(mean) * z + (z * z - 1.0F) / 6.0F);
}
}  // namespace xray_tracking
