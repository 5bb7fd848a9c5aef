#include "xray_tracking_registration/similarity.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
using Values = std::vector<double>;

constexpr int kColumns = 46;
constexpr int kRows = 38;

/// A smooth scene at a shift, with noise of its own.
cv::Mat scene(double shift, double noise, unsigned seed)
{
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0.0, noise);
  cv::Mat image(kRows, kColumns, CV_32FC1);
  for (int v = 0; v < kRows; ++v)
  {
    for (int u = 0; u < kColumns; ++u)
    {
      const double x = u - shift;
      image.at<float>(v, u) = static_cast<float>(std::exp(-0.01 * ((x - 20) * (x - 20) + (v - 15) * (v - 15))) +
                                                 0.4 * std::sin(0.45 * x) * std::cos(0.3 * v) + normal(random));
    }
  }
  return image;
}

/// Mean 0 and standard deviation 1 in double precision.
Values standardised(const cv::Mat& image)
{
  Values values(image.begin<float>(), image.end<float>());
  double mean = 0.0;
  for (const double value : values)
  {
    mean += value / values.size();
  }
  double variance = 0.0;
  for (const double value : values)
  {
    variance += (value - mean) * (value - mean) / values.size();
  }
  for (double& value : values)
  {
    value = (value - mean) / std::sqrt(variance);
  }
  return values;
}

double at(const Values& image, int u, int v)
{
  // Mirrored at the border, the outermost pixel twice.
  u = u < 0 ? -1 - u : u >= kColumns ? 2 * kColumns - 1 - u : u;
  v = v < 0 ? -1 - v : v >= kRows ? 2 * kRows - 1 - v : v;
  return image[v * kColumns + u];
}

/// Sobel gradient along u (du = 1) or v, as differences of weighted means of three pixels two pixels apart.
Values gradient(const Values& image, int du)
{
  const int dv = 1 - du;
  Values result;
  for (int v = 0; v < kRows; ++v)
  {
    for (int u = 0; u < kColumns; ++u)
    {
      double sum = 0.0;
      for (int side = -1; side <= 1; ++side)
      {
        sum += (side == 0 ? 2.0 : 1.0) *
               (at(image, u + du + side * dv, v + dv + side * du) - at(image, u - du + side * dv, v - dv + side * du));
      }
      result.push_back(sum / 8.0);
    }
  }
  return result;
}

double mean(const Values& values)
{
  double sum = 0.0;
  for (const double value : values)
  {
    sum += value;
  }
  return sum / values.size();
}

double covariance(const Values& a, const Values& b)
{
  double sum = 0.0;
  for (std::size_t n = 0; n < a.size(); ++n)
  {
    sum += a[n] * b[n];
  }
  return sum / a.size() - mean(a) * mean(b);
}

double correlation(const Values& a, const Values& b)
{
  return covariance(a, b) / std::sqrt(covariance(a, a) * covariance(b, b));
}

/// The joint histogram as hat functions around the bin centres, bin by bin.
double normalisedMutualInformation(const Values& a, const Values& b)
{
  const auto hat = [](double value, int bin)
  {
    const double place = std::clamp((value + 3.0) / 6.0 * 31.0, 0.0, 31.0);
    return std::max(0.0, 1.0 - std::abs(place - bin));
  };
  const auto information = [](double p) { return p > 0.0 ? -p * std::log2(p) : 0.0; };
  double joint = 0.0;
  Values rows(32, 0.0);
  Values columns(32, 0.0);
  for (int i = 0; i < 32; ++i)
  {
    for (int j = 0; j < 32; ++j)
    {
      double p = 0.0;
      for (std::size_t n = 0; n < a.size(); ++n)
      {
        p += hat(a[n], i) * hat(b[n], j) / a.size();
      }
      joint += information(p);
      rows[i] += p;
      columns[j] += p;
    }
  }
  double marginal = 0.0;
  for (int i = 0; i < 32; ++i)
  {
    marginal += information(rows[i]) + information(columns[i]);
  }
  return marginal / joint - 1.0;
}

double independently(const std::string& name, const cv::Mat& xray, const cv::Mat& drr)
{
  const Values a = standardised(xray);
  const Values b = standardised(drr);
  return name == "gradient_correlation"
             ? 0.5 * (correlation(gradient(a, 0), gradient(b, 0)) + correlation(gradient(a, 1), gradient(b, 1)))
             : normalisedMutualInformation(a, b);
}
}  // namespace

class SimilarityTest : public testing::TestWithParam<std::string>
{
};

TEST_P(SimilarityTest, AgreesWithIndependentComputation)
{
  const auto similarity = makeSimilarity(GetParam());
  for (const double shift : { 0.0, 1.3, -4.0 })
  {
    const cv::Mat xray = scene(0.0, 0.1, 1);
    const cv::Mat drr = scene(shift, 0.05, 2);
    // Single precision of some thousand terms.
    EXPECT_NEAR((*similarity)(xray, drr), independently(GetParam(), xray, drr), 2e-5);
  }
}

TEST_P(SimilarityTest, OptimumOfNoisyImagesIsAtTheTrueShift)
{
  const auto similarity = makeSimilarity(GetParam());
  const cv::Mat xray = scene(0.0, 0.1, 3);
  const double best = (*similarity)(xray, scene(0.0, 0.0, 0));
  for (const double shift : { -3.0, -1.0, -0.5, 0.5, 1.0, 3.0 })
  {
    EXPECT_LT((*similarity)(xray, scene(shift, 0.0, 0)), best) << "at " << shift;
  }
}

TEST_P(SimilarityTest, DoesNotDependOnGainAndOffset)
{
  const auto similarity = makeSimilarity(GetParam());
  const cv::Mat xray = scene(0.0, 0.1, 4);
  const cv::Mat drr = scene(0.7, 0.05, 5);
  EXPECT_NEAR((*similarity)(xray * 37.0 + 1000.0, drr * 0.2 - 3.0), (*similarity)(xray, drr), 1e-3);
}

TEST_P(SimilarityTest, StaysNearTheTruthUnderScatter)
{
  const auto similarity = makeSimilarity(GetParam());
  cv::Mat xray = scene(0.0, 0.03, 6);
  for (int v = 0; v < kRows; ++v)
  {
    for (int u = 0; u < kColumns; ++u)
    {
      xray.at<float>(v, u) += static_cast<float>(0.3 * std::exp(-0.001 * ((u - 30) * (u - 30) + (v - 8) * (v - 8))));
    }
  }
  double best = -1.0;
  double best_shift = 0.0;
  for (double shift = -4.0; shift <= 4.0; shift += 0.25)
  {
    const double value = (*similarity)(xray, scene(shift, 0.0, 0));
    if (value > best)
    {
      best = value;
      best_shift = shift;
    }
  }
  EXPECT_LE(std::abs(best_shift), 0.5);
}

TEST_P(SimilarityTest, ConstantImageGivesZero)
{
  const auto similarity = makeSimilarity(GetParam());
  const cv::Mat constant(kRows, kColumns, CV_32FC1, cv::Scalar(0.37));
  EXPECT_EQ((*similarity)(constant, scene(0.0, 0.1, 7)), 0.0);
  EXPECT_EQ((*similarity)(scene(0.0, 0.1, 7), constant), 0.0);
}

TEST_P(SimilarityTest, RefusesOtherImages)
{
  const auto similarity = makeSimilarity(GetParam());
  const cv::Mat image = scene(0.0, 0.1, 8);
  EXPECT_THROW((*similarity)(image, image.colRange(1, kColumns)), std::invalid_argument);
  EXPECT_THROW((*similarity)(image.colRange(0, 4), image.colRange(0, 4)), std::invalid_argument);
  EXPECT_THROW((*similarity)(cv::Mat(kRows, kColumns, CV_16UC1), image), std::invalid_argument);
}

INSTANTIATE_TEST_SUITE_P(All, SimilarityTest, testing::ValuesIn(similarityNames()),
                         [](const auto& info) { return info.param; });

TEST(Similarity, UnknownNameNamesThoseThereAre)
{
  try
  {
    makeSimilarity("mutual");
    FAIL();
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find("'mutual'"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("gradient_correlation"), std::string::npos);
  }
}
}  // namespace xray_tracking
