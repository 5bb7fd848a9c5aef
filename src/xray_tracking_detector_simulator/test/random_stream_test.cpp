#include "xray_tracking_detector_simulator/random_stream.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/normal.hpp>
#include <boost/math/distributions/poisson.hpp>

namespace xray_tracking
{
namespace
{
// Bounds of five standard errors: a right generator fails such a test in one of 1.7 million seeds.
constexpr double kSigmas = 5.0;

std::vector<float> normals(std::uint64_t seed, int rows, int columns)
{
  std::vector<float> values(static_cast<std::size_t>(rows) * columns);
  for (int row = 0; row < rows; ++row)
  {
    RandomStream(seed).part(row).fillNormal(values.data() + static_cast<std::size_t>(row) * columns, columns);
  }
  return values;
}

double centralMoment(const std::vector<float>& values, double mean, int order)
{
  double sum = 0.0;
  for (const float value : values)
  {
    sum += std::pow(value - mean, order);
  }
  return sum / static_cast<double>(values.size());
}

TEST(RandomStream, NormalNumbersHaveTheMomentsOfTheNormalDistribution)
{
  const std::vector<float> values = normals(1, 1000, 512);
  const auto n = static_cast<double>(values.size());
  EXPECT_NEAR(centralMoment(values, 0.0, 1), 0.0, kSigmas / std::sqrt(n));
  EXPECT_NEAR(centralMoment(values, 0.0, 2), 1.0, kSigmas * std::sqrt(2.0 / n));
  EXPECT_NEAR(centralMoment(values, 0.0, 3), 0.0, kSigmas * std::sqrt(15.0 / n));
  EXPECT_NEAR(centralMoment(values, 0.0, 4), 3.0, kSigmas * std::sqrt(96.0 / n));
}

TEST(RandomStream, NormalNumbersFollowTheDistributionFunction)
{
  std::vector<float> values = normals(2, 200, 512);
  std::sort(values.begin(), values.end());
  const boost::math::normal normal;
  const auto n = static_cast<double>(values.size());
  double distance = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i)
  {
    distance = std::max(distance, std::abs(boost::math::cdf(normal, values[i]) - (i + 0.5) / n));
  }
  // Kolmogorov and Smirnov's statistic exceeds 2.5 / sqrt(n) with a probability of 7e-6.
  EXPECT_LT(distance, 2.5 / std::sqrt(n));
}

TEST(RandomStream, NeighboursInRowAndColumnAreUncorrelated)
{
  constexpr int kRows = 1000;
  constexpr int kColumns = 300;  // no multiple of a block
  const std::vector<float> values = normals(3, kRows, kColumns);
  for (const int lag : { 1, 150, kColumns })
  {
    double sum = 0.0;
    for (std::size_t i = lag; i < values.size(); ++i)
    {
      sum += static_cast<double>(values[i]) * values[i - lag];
    }
    const auto n = static_cast<double>(values.size() - lag);
    EXPECT_NEAR(sum / n, 0.0, kSigmas / std::sqrt(n)) << "lag " << lag;
  }
}

TEST(RandomStream, OddCountsAreFilled)
{
  for (const int count : { 1, 2, 511, 512, 513, 1025 })
  {
    std::vector<float> values(count + 1, 99.0F);
    RandomStream(4).fillNormal(values.data(), count);
    EXPECT_TRUE(std::all_of(values.begin(), values.end() - 1, [](float z) { return std::abs(z) < 6.0F; })) << count;
    EXPECT_EQ(values.back(), 99.0F) << count;
  }
}

TEST(RandomStream, PartsAndIndicesGiveDifferentNumbers)
{
  std::vector<std::uint64_t> bits;
  for (std::uint64_t part = 0; part < 100; ++part)
  {
    for (std::uint64_t index = 0; index < 100; ++index)
    {
      bits.push_back(RandomStream(5).part(part).bits(index));
      bits.push_back(RandomStream(part).bits(index));
      bits.push_back(RandomStream(5).part(3).part(part).bits(index));
    }
  }
  std::sort(bits.begin(), bits.end());
  EXPECT_EQ(std::unique(bits.begin(), bits.end()), bits.end());
}

class PoissonFromNormal : public testing::TestWithParam<double>
{
};

TEST_P(PoissonFromNormal, HasMeanAndVariance)
{
  const double mean = GetParam();
  std::vector<float> values = normals(6, 1000, 512);
  for (float& value : values)
  {
    value = poissonFromNormal(static_cast<float>(mean), value);
  }
  const auto n = static_cast<double>(values.size());
  const double sample_mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  EXPECT_NEAR(sample_mean, mean, kSigmas * std::sqrt(mean / n));
  // The expansion's own excess of variance; standard error from the distribution's fourth moment.
  const double variance = mean + (mean < 16.0 ? 0.0 : 1.0 / 18.0);
  EXPECT_NEAR(centralMoment(values, sample_mean, 2), variance, kSigmas * std::sqrt((2.0 * mean * mean + mean) / n));
  EXPECT_GE(*std::min_element(values.begin(), values.end()), 0.0F);
}

INSTANTIATE_TEST_SUITE_P(Means, PoissonFromNormal, testing::Values(0.0, 0.3, 4.0, 15.9, 16.0, 60.0, 1e3, 6e4));

TEST(PoissonFromNormalTest, SmallMeansFollowTheDistribution)
{
  constexpr double kMean = 5.0;
  constexpr int kBins = 15;  // the last one holds all that is above
  std::vector<double> counts(kBins, 0.0);
  const std::vector<float> values = normals(7, 200, 512);
  for (const float value : values)
  {
    ++counts[std::min(static_cast<int>(poissonFromNormal(static_cast<float>(kMean), value)), kBins - 1)];
  }
  const boost::math::poisson poisson(kMean);
  double chi_square = 0.0;
  for (int k = 0; k < kBins; ++k)
  {
    const double probability = k < kBins - 1 ? boost::math::pdf(poisson, k) : 1.0 - boost::math::cdf(poisson, k - 1);
    const double expected = probability * static_cast<double>(values.size());
    chi_square += (counts[k] - expected) * (counts[k] - expected) / expected;
  }
  EXPECT_LT(chi_square, boost::math::quantile(boost::math::chi_squared(kBins - 1), 1.0 - 1e-5));
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
