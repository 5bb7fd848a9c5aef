#include "kernels.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>

#include "point_sampler.h"
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

/// By truncated powers.
double cubicSpline(double t)
{
  const auto cube = [](double v) { return v > 0.0 ? v * v * v : 0.0; };
  return (cube(t + 2) - 4 * cube(t + 1) + 6 * cube(t) - 4 * cube(t - 1) + cube(t - 2)) / 6.0;
}

/// Of all pixels; those beyond the border are as the nearest ones.
double splineSample(const cv::Mat& pixels, double column, double row)
{
  double sum = 0.0;
  for (int r = -2; r < pixels.rows + 2; ++r)
  {
    for (int c = -2; c < pixels.cols + 2; ++c)
    {
      const int y = std::clamp(r, 0, pixels.rows - 1), x = std::clamp(c, 0, pixels.cols - 1);
      sum += pixels.at<std::uint16_t>(y, x) * cubicSpline(column - c) * cubicSpline(row - r);
    }
  }
  return sum;
}

TEST(Kernels, splineSamplesEverywhere)
{
  cv::Mat pixels(kHeight, kWidth, CV_16UC1);
  cv::RNG(5).fill(pixels, cv::RNG::UNIFORM, 0, 256);
  cv::Mat bytes;
  pixels.convertTo(bytes, CV_8U);
  std::mt19937 random(4);
  Points points(kCount, 2);
  Eigen::ArrayXf values(kCount), outside(kCount);
  const PixelMap map{ 0.98f, -0.05f, 1.7f, 0.06f, 1.01f, -0.4f };
  IntensityModel attenuation;
  attenuation.kind = IntensityModel::Kind::ATTENUATION;
  // Far enough inside for vectors, and over the border.
  for (const float margin : { 5.f, 0.f })
  {
    std::uniform_real_distribution<float> along_x(margin, kWidth - 1 - margin), along_y(margin, kHeight - 1 - margin);
    for (int i = 0; i < kCount; ++i)
    {
      points.row(i) << along_x(random), along_y(random);
    }
    const Box box(points.colwise().minCoeff().transpose(), points.colwise().maxCoeff().transpose());
    for (const cv::Mat& image : { pixels, bytes })
    {
      const int count = samplePoints(image, Sampling::SPLINE, attenuation, points, box, map, values, outside);
      EXPECT_EQ(count > 0, margin == 0.f);
      for (int i = 0; i < kCount; ++i)
      {
        const double column = 0.98 * points(i, 0) - 0.05 * points(i, 1) + 1.7;
        const double row = 0.06 * points(i, 0) + 1.01 * points(i, 1) - 0.4;
        const double expected =
            splineSample(pixels, std::clamp(column, 0.0, kWidth - 1.0), std::clamp(row, 0.0, kHeight - 1.0));
        EXPECT_NEAR(values[i], expected, 2e-3) << column << ", " << row;
      }
    }
  }
}

TEST(Kernels, splineFilterIsTheSampleAtAPixel)
{
  cv::Mat pixels(kHeight, kWidth, CV_16UC1), values;
  cv::RNG(6).fill(pixels, cv::RNG::UNIFORM, 0, 256);
  pixels.convertTo(values, CV_32F);
  const cv::Mat filtered = splineFiltered(values);
  for (const cv::Point& place : { cv::Point(0, 0), cv::Point(12, 9), cv::Point(kWidth - 1, 17) })
  {
    EXPECT_NEAR(filtered.at<float>(place), splineSample(pixels, place.x, place.y), 1e-3) << place;
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

TEST(Kernels, dotsAsDoubleSums)
{
  for (const int count : { 24, 29 })  // whole vectors, and not
  {
    const Eigen::MatrixXf columns = Eigen::MatrixXf::Random(count, 11);
    const Eigen::VectorXf b = Eigen::VectorXf::Random(count);
    Eigen::VectorXf sums(11);
    dots(columns.data(), 11, b.data(), count, sums.data());
    const Eigen::VectorXd expected = columns.cast<double>().transpose() * b.cast<double>();
    EXPECT_LT((sums.cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-5) << count;
  }
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
