// The estimate of an image's noise, against noise whose spectrum is known in closed form.

#include "noise_spectrum.h"

#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "synthetic_exposure.h"

namespace xray_tracking
{
namespace
{
const cv::Size kImage(240, 200);
constexpr double kDeviation = 0.03;

cv::Mat whiteNoise(std::uint64_t seed)
{
  cv::Mat noise(kImage, CV_32F);
  cv::RNG(seed).fill(noise, cv::RNG::NORMAL, 0.0, kDeviation);
  return noise;
}

/// Attenuation of tests' exposures with an edge, of metal, across it.
cv::Mat structure()
{
  cv::Mat values(kImage, CV_32F);
  for (int y = 0; y < values.rows; ++y)
  {
    for (int x = 0; x < values.cols; ++x)
    {
      values.at<float>(y, x) = static_cast<float>(targetField()(x, y) + (x + 0.3 * y > 150.0 ? 1.5 : 0.0));
    }
  }
  return values;
}

cv::Mat allUsable()
{
  return cv::Mat(kImage, CV_8UC1, cv::Scalar(255));
}

TEST(NoiseSpectrum, findsWhiteNoiseUnderStructure)
{
  const NoiseSpectrum noise(structure() + whiteNoise(1), allUsable(), 0.0);
  // 29 x 24 overlapping blocks, as many as 200 independent ones, with 10 to 40 coefficients a band: to about 3 %, and 6
  // % for the edge that some cross. Blobs of 2.5 px all over the image, without gaps, have some power at 0.2 cycles a
  // pixel, which counts as noise.
  for (const double f : { 0.05, 0.2 })
  {
    EXPECT_GT(std::sqrt(noise.power(f)), 0.95 * kDeviation) << f;
    EXPECT_LT(std::sqrt(noise.power(f)), 1.3 * kDeviation) << f;
  }
  for (const double f : { 0.3, 0.4, 0.5, 0.6 })
  {
    EXPECT_NEAR(std::sqrt(noise.power(f)), kDeviation, 0.1 * kDeviation) << f;
  }
  EXPECT_NEAR(std::sqrt(noise.variance()), kDeviation, 0.1 * kDeviation);
  EXPECT_NEAR(std::sqrt(noise.varianceOfMeans(4)), kDeviation / 4.0, 0.15 * kDeviation / 4.0);
}

// Blurred by a Gaussian of 0.9 px, as an image intensifier's is: neighbours correlate by 0.73.
TEST(NoiseSpectrum, findsTheSpectrumOfCorrelatedNoise)
{
  constexpr double kBlur = 0.9;
  cv::Mat noise = whiteNoise(2);
  cv::GaussianBlur(noise, noise, cv::Size(15, 15), kBlur, kBlur, cv::BORDER_REFLECT);
  const NoiseSpectrum spectrum(structure() + noise, allUsable(), 0.0);
  for (const double f : { 0.2, 0.25, 0.3, 0.35 })
  {
    const double gain = std::exp(-2.0 * std::pow(M_PI * kBlur * f, 2));
    EXPECT_NEAR(std::sqrt(spectrum.power(f)), kDeviation * gain, 0.25 * kDeviation * gain) << f;
  }
  // Below 0.17 cycles a pixel it is taken to be flat: less than it is by that gain, 0.79 there, and never more.
  EXPECT_LT(std::sqrt(spectrum.slowPower()), 1.1 * kDeviation);
  EXPECT_GT(std::sqrt(spectrum.slowPower()), 0.55 * kDeviation);
}

TEST(NoiseSpectrum, leavesOutWhatIsSaturated)
{
  // Half of the image is air, at full scale.
  cv::Mat values = structure() + whiteNoise(3);
  cv::Mat counts;
  cv::exp(-values, counts);
  cv::Mat image;
  counts.convertTo(image, CV_8U, 150.0);
  image.colRange(120, 240).setTo(255);
  const cv::Rect whole(cv::Point(), image.size());
  const cv::Mat usable = unsaturated(image, whole, {});
  EXPECT_EQ(cv::countNonZero(usable.colRange(120, 240)), 0);
  EXPECT_GT(cv::countNonZero(usable.colRange(0, 120)), 0.98 * 120 * 200);
  image.convertTo(values, CV_32F);
  cv::log(values, values);
  // Eight bits add less than a tenth.
  EXPECT_NEAR(std::sqrt(NoiseSpectrum(-values, usable, 0.0).variance()), kDeviation, 0.12 * kDeviation);
}

TEST(NoiseSpectrum, isAtLeastWhatQuantisationMakes)
{
  const NoiseSpectrum noise(cv::Mat::zeros(kImage, CV_32F), allUsable(), 1e-4);
  EXPECT_NEAR(noise.variance(), 1e-4, 1e-12);
}

TEST(NoiseSpectrum, knowsTheStepOfFewerBits)
{
  cv::Mat image(kImage, CV_8UC1);
  cv::RNG(4).fill(image, cv::RNG::UNIFORM, 0, 64);
  EXPECT_EQ(greyStep(image), 1.0);
  image *= 4;
  EXPECT_EQ(greyStep(image), 4.0);
  // Gaps between few pixels' values are chance.
  cv::Mat fine(kImage, CV_16UC1);
  cv::RNG(5).fill(fine, cv::RNG::UNIFORM, 0, 60000);
  EXPECT_EQ(greyStep(fine), 1.0);
}

TEST(NoiseSpectrum, foldsWhereColumnsAndRowsAreLeftOut)
{
  EXPECT_NEAR(NoiseSpectrum(0.2).foldedPower(0.3, 0.1, 3), 0.04, 1e-12);
  const NoiseSpectrum noise(structure() + whiteNoise(6), allUsable(), 0.0);
  EXPECT_DOUBLE_EQ(noise.foldedPower(0.3, 0.2, 1), noise.power(std::hypot(0.3, 0.2)));
}
}  // namespace
}  // namespace xray_tracking
