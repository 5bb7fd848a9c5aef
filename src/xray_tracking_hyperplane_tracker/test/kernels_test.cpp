#include "kernels.h"

#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>

#include "warp.h"

namespace xray_tracking
{
namespace
{
constexpr int kWidth = 37;
constexpr int kHeight = 29;
constexpr int kCount = 85;  // whole vectors and a rest

TEST(Kernels, sampleBetweenPixels)
{
  std::mt19937 random(3);
  std::vector<std::uint16_t> pixels(kWidth * kHeight);
  for (std::uint16_t& pixel : pixels)
  {
    pixel = static_cast<std::uint16_t>(random());
  }
  std::uniform_real_distribution<float> along_x(3.f, 30.f), along_y(3.f, 22.f);
  std::vector<float> x(kCount), y(kCount), values(kCount);
  for (int i = 0; i < kCount; ++i)
  {
    x[i] = along_x(random);
    y[i] = along_y(random);
  }
  const PixelMap map{ 0.98f, -0.05f, 1.7f, 0.06f, 1.01f, -0.4f };
  sampleBilinear(pixels.data(), kWidth, x.data(), y.data(), kCount, map, values.data());
  for (int i = 0; i < kCount; ++i)
  {
    const double column = 0.98 * x[i] - 0.05 * y[i] + 1.7;
    const double row = 0.06 * x[i] + 1.01 * y[i] - 0.4;
    const int left = static_cast<int>(column), top = static_cast<int>(row);
    double expected = 0.0;
    for (const int c : { left, left + 1 })
    {
      for (const int r : { top, top + 1 })
      {
        expected +=
            pixels[static_cast<std::size_t>(r * kWidth + c)] * (1.0 - std::abs(column - c)) * (1.0 - std::abs(row - r));
      }
    }
    // Places are rounded to 2e-6 px, grey values span 65535 a pixel.
    EXPECT_NEAR(values[i], expected, 0.5);
  }
}

TEST(Kernels, attenuateAsTheLogarithm)
{
  std::vector<float> values(kCount);
  for (int i = 0; i < kCount; ++i)
  {
    values[i] = static_cast<float>(std::exp(0.14 * i) + 60.0);
  }
  values[5] = 3.f;  // below the offset
  std::vector<float> found = values;
  attenuate(found.data(), kCount, 60.f);
  for (int i = 0; i < kCount; ++i)
  {
    const double expected = -std::log(std::max(1.0, static_cast<double>(values[i]) - 60.0));
    EXPECT_NEAR(found[i], expected, 1e-6 * std::max(1.0, std::abs(expected))) << values[i];
  }
}

TEST(Kernels, dotAsADoubleSum)
{
  const Eigen::VectorXf a = Eigen::VectorXf::Random(kCount), b = Eigen::VectorXf::Random(kCount);
  EXPECT_NEAR(dot(a.data(), b.data(), kCount), a.cast<double>().dot(b.cast<double>()), 1e-5);
}

TEST(Warp, exponentialOfARotationIsOne)
{
  Parameters m(3);
  m << 0.f, 0.f, 5.f;
  const Warp warp = Warp::exponential(m, 50.0);
  EXPECT_NEAR(warp.linear(1, 0), std::sin(0.1), 1e-8);
  EXPECT_NEAR(warp.linear(0, 0), std::cos(0.1), 1e-8);
  EXPECT_EQ(warp.translation, Eigen::Vector2d::Zero());
}

TEST(Warp, exponentialIsAOneParameterGroup)
{
  Parameters m(6);
  m << 3.f, -2.f, 4.f, 1.5f, -2.f, 2.5f;
  const Warp half = Warp::exponential(0.5f * m, 40.0);
  const Warp twice = half.after(half), whole = Warp::exponential(m, 40.0);
  EXPECT_LT((twice.linear - whole.linear).norm(), 1e-7);
  EXPECT_LT((twice.translation - whole.translation).norm(), 1e-6);
  const Warp none = whole.after(Warp::exponential(-m, 40.0));
  EXPECT_LT((none.linear - Eigen::Matrix2d::Identity()).norm(), 1e-7);
  EXPECT_LT(none.translation.norm(), 1e-6);
}

TEST(Warp, derivativeAsFiniteDifferences)
{
  Parameters m(6);
  m << 3.f, -2.f, 4.f, 1.5f, -2.f, 2.5f;
  const Warp warp = Warp::exponential(m, 40.0);
  const auto derivative = warpDerivative(warp, 6, 40.0);
  for (int k = 0; k < 6; ++k)
  {
    const float step = 0.01f;
    const Warp plus = warp.after(Warp::exponential(-step * Parameters::Unit(6, k), 40.0));
    const Warp minus = warp.after(Warp::exponential(step * Parameters::Unit(6, k), 40.0));
    const Eigen::Vector2d translation = (plus.translation - minus.translation) / (2.0 * step);
    const Eigen::Matrix2d linear = (plus.linear - minus.linear) / (2.0 * step);
    Eigen::Matrix<double, 6, 1> expected;
    expected << translation, linear(0, 0), linear(0, 1), linear(1, 0), linear(1, 1);
    EXPECT_LT((derivative.col(k) - expected).norm(), 1e-5) << k;
  }
}
}  // namespace
}  // namespace xray_tracking
