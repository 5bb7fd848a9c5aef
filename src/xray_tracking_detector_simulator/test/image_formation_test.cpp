#include "xray_tracking_detector_simulator/image_formation.h"

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <tbb/global_control.h>
#include <opencv2/imgproc.hpp>

#include "test_room.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr double kOffset = 100.0;
constexpr double kAir = 60000.0;
// Half a count of rounding, and single precision of the signal.
constexpr double kRounding = 0.5 + 60000.0 * 2e-6;
// Of a uniform number within a count.
constexpr double kRoundingVariance = 1.0 / 12.0;
// Statistical bounds in standard errors.
constexpr double kSigmas = 5.0;

IntensityModel intensity()
{
  IntensityModel model;
  model.offset = kOffset;
  model.air_counts = kAir;
  return model;
}

ImageFormationOptions ideal()
{
  ImageFormationOptions options;
  options.polychromatic = false;
  options.scatter_fraction = 0.0;
  options.blur_sigma_px = 0.0;
  options.air_quanta = 0.0;
  options.electronic_noise = 0.0;
  options.gain_drift = 0.0;
  options.offset_drift = 0.0;
  return options;
}

cv::Mat lengths(double value, const cv::Size& size = cv::Size(256, 256))
{
  return { size, CV_32FC1, cv::Scalar(value) };
}

cv::Mat form(const ImageFormationOptions& options, const cv::Mat& soft, const cv::Mat& bone, int detector = 0,
             int exposure = 0, std::uint64_t seed = 1)
{
  cv::Mat counts;
  ImageFormation(options, intensity(), seed).form(soft, bone, detector, exposure, counts);
  EXPECT_EQ(counts.type(), CV_16UC1);
  return counts;
}

std::pair<double, double> meanAndVariance(const cv::Mat& counts)
{
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(counts, mean, deviation);
  return { mean[0], deviation[0] * deviation[0] };
}

double expectedCounts(double signal)
{
  return kOffset + (kAir - kOffset) * signal;
}

bool same(const cv::Mat& a, const cv::Mat& b)
{
  return a.size() == b.size() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

TEST(ImageFormation, OneEnergyFollowsBeerAndLambert)
{
  for (const auto& [soft, bone] : { std::pair{ 0.0, 0.0 }, { 120.0, 0.0 }, { 0.0, 30.0 }, { 110.0, 25.0 } })
  {
    const cv::Mat counts = form(ideal(), lengths(soft), lengths(bone));
    const double expected = expectedCounts(std::exp(-kWaterAttenuation * soft - kBoneAttenuation * bone));
    EXPECT_LE(cv::norm(counts, cv::Mat(counts.size(), CV_16UC1, cv::Scalar(std::round(expected))), cv::NORM_INF), 1.0);
    EXPECT_NEAR(cv::mean(counts)[0], expected, kRounding) << soft << " " << bone;
  }
}

TEST(ImageFormation, FiveEnergiesAreTheirDirectSum)
{
  // Written out once more, in cm and g, against a slip in the table or its units.
  const auto transmission = [](double soft_cm, double bone_cm)
  {
    const double bone = 1.92 * bone_cm;
    return 0.16 * std::exp(-0.2683 * soft_cm - 0.6655 * bone) + 0.23 * std::exp(-0.2269 * soft_cm - 0.4242 * bone) +
           0.27 * std::exp(-0.2059 * soft_cm - 0.3148 * bone) + 0.22 * std::exp(-0.1837 * soft_cm - 0.2229 * bone) +
           0.12 * std::exp(-0.1707 * soft_cm - 0.1855 * bone);
  };
  ImageFormationOptions options = ideal();
  options.polychromatic = true;
  for (const auto& [soft, bone] : { std::pair{ 0.0, 0.0 }, { 120.0, 0.0 }, { 0.0, 40.0 }, { 110.0, 25.0 } })
  {
    EXPECT_NEAR(primaryTransmission(filteredBeam(), soft, bone), transmission(soft / 10, bone / 10), 1e-12);
    EXPECT_NEAR(cv::mean(form(options, lengths(soft), lengths(bone)))[0],
                expectedCounts(transmission(soft / 10, bone / 10)), kRounding);
  }
}

TEST(ImageFormation, TheBeamHardens)
{
  const auto attenuation = [](double soft, double bone)
  { return -std::log(primaryTransmission(filteredBeam(), soft, bone)); };
  double soft_before = attenuation(1.0, 0.0);
  double bone_before = attenuation(0.0, 1.0);
  for (double length = 10.0; length <= 300.0; length += 10.0)
  {
    EXPECT_LT(attenuation(length, 0.0) / length, soft_before);
    EXPECT_LT(attenuation(0.0, length) / length, bone_before);
    soft_before = attenuation(length, 0.0) / length;
    bone_before = attenuation(0.0, length) / length;
  }
  // Bone behind soft tissue meets a harder beam than bone alone.
  EXPECT_LT(attenuation(150.0, 20.0), attenuation(150.0, 0.0) + attenuation(0.0, 20.0));
  // The core's constants stand for the middle of the beam.
  EXPECT_GT(attenuation(1.0, 0.0), 0.9 * kWaterAttenuation);
  EXPECT_LT(attenuation(1.0, 0.0), 1.2 * kWaterAttenuation);
}

TEST(ImageFormation, ScatterIsTheFractionOfThePrimaryBehindASlab)
{
  ImageFormationOptions options = ideal();
  options.scatter_fraction = 0.3;
  for (const double length : { 0.0, 30.0, 100.0, 250.0 })
  {
    const double primary = std::exp(-kWaterAttenuation * length);
    const cv::Mat counts = form(options, lengths(length), lengths(0.0));
    EXPECT_NEAR(cv::mean(counts)[0], expectedCounts(primary + 0.3 * primary * (1.0 - primary)), kRounding);
    // Flat: the panel's edges do not show.
    double low = 0.0;
    double high = 0.0;
    cv::minMaxLoc(counts, &low, &high);
    EXPECT_LE(high - low, 1.0);
  }
}

TEST(ImageFormation, ScatterSpreadsWidelyAndSmoothly)
{
  ImageFormationOptions options = ideal();
  options.scatter_fraction = 0.5;
  options.scatter_sigma_px = 24.0;
  const cv::Size size(300, 200);  // no multiple of the coarse grid
  cv::Mat soft = lengths(0.0, size);
  soft.colRange(150, 300).setTo(80.0);
  cv::Mat scattered;
  cv::subtract(form(options, soft, lengths(0.0, size)), form(ideal(), soft, lengths(0.0, size)), scattered,
               cv::noArray(), CV_32F);
  const double primary = std::exp(-kWaterAttenuation * 80.0);
  const double plateau = (kAir - kOffset) * 0.5 * primary * (1.0 - primary);
  for (const int column : { 90, 120, 140, 149, 150, 160, 180, 210 })
  {
    // A step at 149.5 spread by a Gaussian. The coarse grid's steps of 8 px add a box's and a triangle's spread, the
    // step falls inside a cell: up to half a cell of shift, 4 px / (24 px sqrt(2 pi)) = 7 % of the plateau.
    const double expected = plateau * 0.5 * std::erfc(-(column - 149.5) / (24.0 * std::sqrt(2.0)));
    EXPECT_NEAR(scattered.at<float>(100, column), expected, 0.07 * plateau) << column;
  }
}

TEST(ImageFormation, BlurKeepsTheSumAndWidensAnEdgeBySigma)
{
  constexpr double kSigma = 2.0;
  ImageFormationOptions options = ideal();
  options.blur_sigma_px = kSigma;
  cv::Mat bone = lengths(0.0);
  bone(cv::Rect(100, 60, 70, 120)).setTo(30.0);
  const cv::Mat sharp = form(ideal(), lengths(20.0), bone);
  const cv::Mat blurred = form(options, lengths(20.0), bone);
  const double pixels = static_cast<double>(bone.total());
  EXPECT_NEAR(cv::sum(blurred)[0], cv::sum(sharp)[0],
              kSigmas * std::sqrt(2.0 * kRoundingVariance * pixels) + 2e-6 * cv::sum(sharp)[0]);

  const double high = sharp.at<std::uint16_t>(120, 50);
  const double low = sharp.at<std::uint16_t>(120, 130);
  for (int column = 90; column < 110; ++column)
  {
    const double expected = low + (high - low) * 0.5 * std::erfc((column - 99.5) / (kSigma * std::sqrt(2.0)));
    // The kernel is sampled and ends at 4 sigma: 6e-5 of the tails, and the trapezoid rule's error.
    EXPECT_NEAR(blurred.at<std::uint16_t>(120, column), expected, 0.005 * (high - low)) << column;
  }
}

TEST(ImageFormation, QuantumNoiseHasThePoissonVariance)
{
  ImageFormationOptions options = ideal();
  for (const double quanta : { 500.0, 60000.0 })
  {
    options.air_quanta = quanta;
    for (const double length : { 0.0, 60.0, 150.0, 250.0 })
    {
      // With 16 bits and 500 quanta the noise behind air saturates.
      if (quanta < 1000.0 && length == 0.0)
      {
        continue;
      }
      const double signal = std::exp(-kWaterAttenuation * length);
      const double counts_per_quantum = (kAir - kOffset) / quanta;
      const auto [mean, variance] = meanAndVariance(form(options, lengths(length), lengths(0.0)));
      const double expected = counts_per_quantum * counts_per_quantum * quanta * signal + kRoundingVariance;
      const double n = 256.0 * 256.0;
      EXPECT_NEAR(mean, expectedCounts(signal), kSigmas * std::sqrt(expected / n) + kRounding - 0.5);
      // Chi-square of n degrees, widened by the Poisson distribution's kurtosis, and the expansion's excess of 1/18.
      const double mean_quanta = quanta * signal;
      EXPECT_NEAR(variance / expected, 1.0,
                  kSigmas * std::sqrt((2.0 + 1.0 / mean_quanta) / n) + 1.0 / (18.0 * mean_quanta));
    }
  }
}

TEST(ImageFormation, ElectronicNoiseHasItsDeviation)
{
  ImageFormationOptions options = ideal();
  options.electronic_noise = 20.0;
  const auto [mean, variance] = meanAndVariance(form(options, lengths(100.0), lengths(0.0)));
  const double expected = 400.0 + kRoundingVariance;
  EXPECT_NEAR(mean, expectedCounts(std::exp(-kWaterAttenuation * 100.0)), kSigmas * 20.0 / 256.0 + kRounding - 0.5);
  EXPECT_NEAR(variance / expected, 1.0, kSigmas * std::sqrt(2.0) / 256.0);
}

TEST(ImageFormation, CountsSaturateAndDoNotWrap)
{
  ImageFormationOptions options = ideal();
  options.electronic_noise = 1000.0;
  for (const auto& [bits, most] : { std::pair{ 14, 16383.0 }, { 15, 32767.0 }, { 16, 65535.0 } })
  {
    options.bits = bits;
    options.gain_drift = 0.0;
    double high = 0.0;
    cv::minMaxLoc(form(options, lengths(0.0), lengths(0.0)), nullptr, &high);
    // Behind air 60000 counts; with 16 bits the noise of 1000 counts reaches the bound at 5.5 sd in no one's sample.
    EXPECT_LE(high, most);
    if (bits < 16)
    {
      EXPECT_EQ(cv::countNonZero(form(options, lengths(0.0), lengths(0.0)) != most), 0);
    }
  }
  options.bits = 16;
  const cv::Mat dark = form(options, lengths(2000.0), lengths(0.0));
  double high = 0.0;
  cv::minMaxLoc(dark, nullptr, &high);
  EXPECT_LT(high, kOffset + 6.0 * 1000.0);
  // P(noise < -offset) = Phi(-0.1) = 0.46
  EXPECT_NEAR(1.0 - cv::countNonZero(dark) / 65536.0, 0.46, 0.02);
}

TEST(ImageFormation, GainAndOffsetDriftSlowlyWithinTheirBounds)
{
  ImageFormationOptions gain = ideal();
  gain.gain_drift = 0.05;
  ImageFormationOptions offset = ideal();
  offset.offset_drift = 50.0;
  std::array<double, 2> last{};
  std::array<double, 2> largest{};
  for (int exposure = 0; exposure < 200; ++exposure)
  {
    const std::array<double, 2> value = {
      (cv::mean(form(gain, lengths(50.0, { 8, 8 }), lengths(0.0, { 8, 8 }), 0, exposure))[0] - kOffset) /
              ((kAir - kOffset) * std::exp(-kWaterAttenuation * 50.0)) -
          1.0,
      cv::mean(form(offset, lengths(50.0, { 8, 8 }), lengths(0.0, { 8, 8 }), 0, exposure))[0] -
          expectedCounts(std::exp(-kWaterAttenuation * 50.0)),
    };
    const std::array<double, 2> bound = { 0.05, 50.0 };
    for (int i = 0; i < 2; ++i)
    {
      const double rounding = i == 0 ? kRounding / 20000.0 : kRounding;
      EXPECT_LE(std::abs(value[i]), bound[i] + rounding);
      if (exposure > 0)
      {
        // The fastest wave is 20 exposures long: slope 2 pi / 20 of the bound.
        EXPECT_LE(std::abs(value[i] - last[i]), 0.315 * bound[i] + 2.0 * rounding);
      }
      largest[i] = std::max(largest[i], std::abs(value[i]) / bound[i]);
    }
    last = value;
  }
  EXPECT_GT(largest[0], 0.5);
  EXPECT_GT(largest[1], 0.5);
}

TEST(ImageFormation, NoiseDependsOnSeedDetectorAndExposureAlone)
{
  const ImageFormationOptions options;
  cv::Mat soft(300, 700, CV_32FC1);  // rows longer than a block of pixels
  cv::randu(soft, 50.0, 150.0);
  const cv::Mat bone = lengths(10.0, soft.size());
  const cv::Mat reference = form(options, soft, bone, 1, 5, 7);
  EXPECT_FALSE(same(reference, form(options, soft, bone, 0, 5, 7)));
  EXPECT_FALSE(same(reference, form(options, soft, bone, 1, 6, 7)));
  EXPECT_FALSE(same(reference, form(options, soft, bone, 1, 5, 8)));

  // In another order, with the buffers used for something else before.
  ImageFormation formation(options, intensity(), 7);
  cv::Mat counts;
  formation.form(lengths(1.0), lengths(2.0), 0, 9, counts);
  formation.form(soft, bone, 1, 6, counts);
  formation.form(soft, bone, 1, 5, counts);
  EXPECT_TRUE(same(reference, counts));

  for (const int threads : { 1, 2, 5 })
  {
    const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    EXPECT_TRUE(same(reference, form(options, soft, bone, 1, 5, 7))) << threads << " threads";
  }
}

TEST(ImageFormation, DetectorsAndExposuresHaveIndependentNoise)
{
  ImageFormationOptions options = ideal();
  options.air_quanta = 60000.0;
  const auto noise = [&](int detector, int exposure)
  {
    cv::Mat counts;
    form(options, lengths(100.0), lengths(0.0), detector, exposure).convertTo(counts, CV_64F);
    cv::Mat centred = counts - cv::mean(counts);
    return cv::Mat(centred / cv::norm(centred));
  };
  const cv::Mat reference = noise(0, 0);
  for (const cv::Mat& other : { noise(1, 0), noise(0, 1), noise(1, 1) })
  {
    EXPECT_NEAR(reference.dot(other), 0.0, kSigmas / 256.0);
  }
}

TEST(ImageFormation, BadOptionsAreNamed)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<std::pair<std::string, std::function<void(ImageFormationOptions&)>>> cases = {
    { "image/scatter_fraction is 1.5", [](auto& o) { o.scatter_fraction = 1.5; } },
    { "image/scatter_sigma_px is 2", [](auto& o) { o.scatter_sigma_px = 2.0; } },
    { "image/blur_sigma_px is -1", [](auto& o) { o.blur_sigma_px = -1.0; } },
    { "image/air_quanta is nan", [nan](auto& o) { o.air_quanta = nan; } },
    { "image/electronic_noise is -5", [](auto& o) { o.electronic_noise = -5.0; } },
    { "image/gain_drift is 2", [](auto& o) { o.gain_drift = 2.0; } },
    { "image/offset_drift is inf", [](auto& o) { o.offset_drift = std::numeric_limits<double>::infinity(); } },
    { "image/bits is 8", [](auto& o) { o.bits = 8; } },
  };
  EXPECT_NO_THROW(ImageFormationOptions().validate());
  for (const auto& [text, spoil] : cases)
  {
    ImageFormationOptions options;
    spoil(options);
    expectThrowNaming<std::invalid_argument>(text, [&] { options.validate(); });
    expectThrowNaming<std::invalid_argument>(text, [&] { ImageFormation(options, intensity(), 1); });
  }
}

TEST(ImageFormation, AnIntensityThatIsNotCountsIsRefused)
{
  IntensityModel model = intensity();
  model.kind = IntensityModel::Kind::ATTENUATION;
  expectThrowNaming<std::invalid_argument>("intensity.kind", [&] { ImageFormation({}, model, 1); });
  model = intensity();
  model.air_counts.reset();
  expectThrowNaming<std::invalid_argument>("intensity.air_counts is absent", [&] { ImageFormation({}, model, 1); });
  model.air_counts = 50.0;
  expectThrowNaming<std::invalid_argument>("intensity.air_counts is 50", [&] { ImageFormation({}, model, 1); });
  model.air_counts = 70000.0;
  expectThrowNaming<std::invalid_argument>("intensity.air_counts is 70000", [&] { ImageFormation({}, model, 1); });
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
