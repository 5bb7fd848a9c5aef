#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <random>

#include <gtest/gtest.h>

#include "phantom_samples.h"
#include "test_helpers.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"

namespace xray_tracking
{
namespace
{
using Eigen::Vector3d;

/// Mean of a CT around a patient point.
double meanHu(const CtVolume& ct, const Vector3d& centre, const Vector3d& half_size)
{
  const Eigen::Affine3d index_from_patient = ct.grid.patient_from_index.inverse();
  const Eigen::Vector3i low = (index_from_patient * (centre - half_size)).array().round().cast<int>();
  const Eigen::Vector3i high = (index_from_patient * (centre + half_size)).array().round().cast<int>();
  double sum = 0.0;
  for (int k = low.z(); k <= high.z(); ++k)
  {
    for (int j = low.y(); j <= high.y(); ++j)
    {
      for (int i = low.x(); i <= high.x(); ++i)
      {
        sum += ct.hu.at(ct.grid.offset(i, j, k));
      }
    }
  }
  return sum / (high - low + Eigen::Vector3i::Ones()).prod();
}

TEST(NeckPhantomCt, TissuesHaveTheirHoundsfieldUnits)
{
  const CtVolume ct = phantom().sampleCt({});
  ASSERT_EQ(ct.hu.size(), 200u * 200u * 160u);
  EXPECT_LT(ct.grid.centre().norm(), 1e-9);
  EXPECT_TRUE(ct.grid.spacing().isApprox(Vector3d(1.0, 1.0, 1.25)));
  // Noise of 20 HU over 100 voxels and more: 2 HU.
  EXPECT_NEAR(meanHu(ct, { 35.0, 35.0, 0.0 }, { 5.0, 5.0, 5.0 }), 50.0, 5.0) << "muscle";
  EXPECT_NEAR(meanHu(ct, { 0.8, -16.5, 0.0 }, { 5.0, 1.0, 3.0 }), -1000.0, 25.0) << "pharynx, clipped at -1024";
  EXPECT_NEAR(meanHu(ct, { 90.0, 90.0, 0.0 }, { 5.0, 5.0, 5.0 }), -1000.0, 25.0) << "air";
  EXPECT_NEAR(meanHu(ct, { 0.0, 0.9, -9.0 }, { 4.0, 3.0, 0.5 }), 95.0, 12.0) << "disc C4/5";
  EXPECT_NEAR(meanHu(ct, { 0.0, -0.5, 0.0 }, { 4.0, 4.0, 3.0 }), 300.0, 60.0) << "marrow and trabeculae of C4";
}

TEST(NeckPhantomCt, VoxelsAreAveragesOverTheirVolume)
{
  PhantomCtOptions options;
  options.noise_hu = 0.0;
  options.size = { 60, 90, 30 };
  const CtVolume ct = phantom().sampleCt(options);
  std::mt19937 generator(3);
  double squares = 0.0, sum = 0.0;
  int n = 0;
  while (n < 120)
  {
    const Eigen::Vector3i voxel(generator() % 60, generator() % 90, generator() % 30);
    const Vector3d centre = ct.grid.patient_from_index * voxel.cast<double>();
    constexpr int kPoints = 12;
    double mean = 0.0, low = 1e9, high = -1e9;
    for (int i = 0; i < kPoints * kPoints * kPoints; ++i)
    {
      const Eigen::Array3d share(i % kPoints, i / kPoints % kPoints, i / (kPoints * kPoints));
      const Vector3d offset = ((share + 0.5) / kPoints - 0.5) * options.spacing.array();
      const double hu = huFromMaterials(phantom().at(centre + offset));
      mean += hu / (kPoints * kPoints * kPoints);
      low = std::min(low, hu);
      high = std::max(high, hu);
    }
    if (high - low < 200.0)
    {
      continue;  // no edge: nothing to average
    }
    const double error = ct.hu[ct.grid.offset(voxel.x(), voxel.y(), voxel.z())] - mean;
    // The worst that 4 lines across a voxel can do: an eighth of the contrast, and 1/24 of it is the reference's own.
    EXPECT_LT(std::abs(error), (1.0 / 8.0 + 1.0 / 24.0) * (high - low) + 1.0) << centre.transpose();
    sum += error;
    squares += error * error;
    ++n;
  }
  EXPECT_LT(std::sqrt(squares / n), 20.0);
  EXPECT_LT(std::abs(sum / n), 4.0);
}

TEST(NeckPhantomCt, NoiseIsWhiteAndSeeded)
{
  PhantomCtOptions options;
  options.size = { 60, 60, 20 };
  const CtVolume first = phantom().sampleCt(options);
  EXPECT_EQ(phantom().sampleCt(options).hu, first.hu);
  options.seed = 2;
  const CtVolume second = phantom().sampleCt(options);
  options.noise_hu = 0.0;
  const CtVolume clean = phantom().sampleCt(options);
  // Where the scanner's lower limit does not cut the noise off.
  double sum = 0.0, squares = 0.0, between_seeds = 0.0, between_slices = 0.0;
  int n = 0;
  const std::size_t slice = clean.grid.offset(0, 0, 1);
  for (std::size_t i = 0; i + slice < clean.hu.size(); ++i)
  {
    if (clean.hu[i] > -900 && clean.hu[i + slice] > -900)
    {
      const double noise = first.hu[i] - clean.hu[i];
      sum += noise;
      squares += noise * noise;
      between_seeds += noise * (second.hu[i] - clean.hu[i]);
      between_slices += noise * (first.hu[i + slice] - clean.hu[i + slice]);
      ++n;
    }
  }
  ASSERT_GT(n, 50000);
  // Five standard errors of n values.
  const double five = 5.0 / std::sqrt(n);
  EXPECT_NEAR(sum / n, 0.0, 20.0 * five);
  EXPECT_NEAR(std::sqrt(squares / n), 20.0, 20.0 * five);
  EXPECT_NEAR(between_seeds / squares, 0.0, five);
  EXPECT_NEAR(between_slices / squares, 0.0, five);
}

TEST(NeckPhantomCt, SliceThicknessBlursAlongZ)
{
  // The hard palate is a plate of 650 HU at z = 58.4 to 61.6 mm, in muscle of 50 HU.
  PhantomCtOptions options;
  options.size = { 5, 130, 260 };
  options.spacing = { 1.0, 1.0, 0.5 };
  options.noise_hu = 0.0;
  for (const double thickness : { 0.5, 1.25, 3.0, 5.0 })
  {
    options.slice_thickness = thickness;
    const CtVolume ct = phantom().sampleCt(options);
    for (double z = 54.25; z < 64.9; z += 0.5)
    {
      const double overlap = std::min(z + 0.5 * thickness, 61.6) - std::max(z - 0.5 * thickness, 58.4);
      const double expected = 50.0 + 600.0 * std::max(0.0, overlap) / thickness;
      // Four lines over the thickness: each of two edges is off by up to an eighth.
      EXPECT_NEAR(meanHu(ct, { 0.0, -56.5, z }, { 1.0, 2.0, 0.0 }), expected, 2.0 * 600.0 / 8.0 + 1.0)
          << "z " << z << ", thickness " << thickness;
    }
    const double peak = meanHu(ct, { 0.0, -56.5, 60.25 }, { 1.0, 2.0, 0.0 });
    EXPECT_NEAR(peak, thickness < 3.0 ? 650.0 : 50.0 + 600.0 * 3.0 / thickness, 61.0) << "thickness " << thickness;
  }
}

TEST(NeckPhantomCt, RadiographsOfItAgreeWithTheExactOnes)
{
  PhantomCtOptions options;
  options.noise_hu = 0.0;  // the noise of air, of which only the upper half attenuates, would be a bias
  const ShearWarpRenderer renderer(attenuationVolume(phantom().sampleCt(options)));
  for (const ProjectionGeometry& geometry : setup().detectors)
  {
    cv::Mat drr, soft, bone;
    renderer.render(geometry, setup().room_from_patient, drr);
    phantom().lineIntegrals(geometry, setup().room_from_patient, setup().room_from_patient, soft, bone);
    const cv::Mat exact = kWaterAttenuation * soft + kBoneAttenuation * bone;
    const cv::Rect target = projectedTargetRegion(setup(), geometry);
    const cv::Mat difference = drr(target) - exact(target);
    cv::Scalar mean, deviation;
    cv::meanStdDev(difference, mean, deviation);
    const double level = cv::mean(exact(target))[0];
    // Edges differ by the blur of 1 mm voxels, which does not change the mean.
    EXPECT_LT(std::abs(mean[0]) / level, 0.003) << geometry.name();
    EXPECT_LT(deviation[0] / level, 0.015) << geometry.name();
    EXPECT_GT(correlation(detail(drr)(target), detail(exact)(target)), 0.9) << geometry.name();
  }
}

TEST(NeckPhantomCt, RefusesBadOptions)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refuses = [](const std::string& option, const std::function<void(PhantomCtOptions&)>& spoil)
  {
    PhantomCtOptions options;
    spoil(options);
    expectError<std::invalid_argument>([&options] { phantom().sampleCt(options); }, { option, "expected" });
  };
  refuses("size", [](PhantomCtOptions& o) { o.size.y() = 0; });
  refuses("size", [](PhantomCtOptions& o) { o.size.z() = 100000; });
  refuses("spacing", [](PhantomCtOptions& o) { o.spacing.x() = -1.0; });
  refuses("spacing", [nan](PhantomCtOptions& o) { o.spacing.z() = nan; });
  refuses("slice_thickness", [](PhantomCtOptions& o) { o.slice_thickness = 0.0; });
  refuses("noise_hu", [](PhantomCtOptions& o) { o.noise_hu = -1.0; });
  refuses("noise_hu", [nan](PhantomCtOptions& o) { o.noise_hu = nan; });
}
}  // namespace
}  // namespace xray_tracking
