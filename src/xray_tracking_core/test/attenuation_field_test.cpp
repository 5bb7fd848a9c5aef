#include "xray_tracking_core/projection/attenuation_field.h"

#include <memory>
#include <stdexcept>

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "drr_samples.h"

namespace xray_tracking
{
namespace
{
std::shared_ptr<const ScalarVolume> blobVolume()
{
  return std::make_shared<const ScalarVolume>(fill(makeGrid({ 64, 60, 56 }, { 1.0, 1.1, 1.2 }), blobs));
}

const ProjectionGeometry kPanel = makeGeometry({ 40, 36 }, 1.5, 5.0, 0.1);

cv::Mat cast(const AttenuationField& field, const RigidTransform& pose)
{
  return castRays(kPanel, PixelGrid::wholePanel(kPanel), pose, [&](const Ray& ray) { return field.lineIntegral(ray); });
}

/// Root mean square over all poses, relative.
double error(double step)
{
  const auto volume = blobVolume();
  const AttenuationField field(volume, step, 1 << 24);
  double difference = 0.0;
  double energy = 0.0;
  for (const RigidTransform& pose : poses())
  {
    const cv::Mat exact = castTrilinear(*volume, kPanel, PixelGrid::wholePanel(kPanel), pose);
    difference += cv::norm(cast(field, pose), exact, cv::NORM_L2SQR);
    energy += cv::norm(exact, cv::NORM_L2SQR);
  }
  return std::sqrt(difference / energy);
}
}  // namespace

TEST(AttenuationFieldTest, ErrorIsThatOfAShiftOfAFractionOfAStep)
{
  // A shift by s changes a blob of width sigma by s / sigma / sqrt(2) of its RMS along one axis. A crossing is off by
  // step / sqrt(12) RMS at either plane and 1 / sqrt(2) of that half way, in two axes: 0.20 * step / sigma, of blobs of
  // 4 to 6 mm.
  EXPECT_LT(error(0.5), 0.2 * 0.5 / 4.0);
  EXPECT_GT(error(0.5), 0.2 * 0.5 / 6.0 / 2.0);
  EXPECT_NEAR(error(0.25) / error(0.5), 0.5, 0.1);
}

TEST(AttenuationFieldTest, FindsAgainWhatItHasComputed)
{
  const AttenuationField field(blobVolume(), 0.5, 1 << 24);
  const cv::Mat first = cast(field, poses()[0]);
  const auto rays = static_cast<std::uint64_t>(first.total());
  EXPECT_EQ(field.statistics().lookups, rays);
  EXPECT_LT(field.statistics().hits, rays / 10) << "rays 1 mm apart at the volume share few cells of 0.5 mm";
  const std::uint64_t hits = field.statistics().hits;
  EXPECT_EQ(cv::norm(first, cast(field, poses()[0])), 0.0);
  EXPECT_EQ(field.statistics().hits, hits + rays);
  // A pose that is a little off still finds most.
  cast(field, motionAbout(Eigen::Vector3d::Zero(), (Twist() << 0, 0, 0, 0.05, 0.05, 0.05).finished()) * poses()[0]);
  EXPECT_GT(field.statistics().hits, hits + rays + rays / 2);
}

TEST(AttenuationFieldTest, StaysWithinItsMemoryAndRight)
{
  const AttenuationField small(blobVolume(), 0.5, 10000);
  const AttenuationField large(blobVolume(), 0.5, 1 << 24);
  EXPECT_LE(small.memory(), 10000u);
  for (const RigidTransform& pose : poses())
  {
    EXPECT_EQ(cv::norm(cast(small, pose), cast(large, pose)), 0.0);
  }
  EXPECT_LE(small.memory(), 10000u);
}

TEST(AttenuationFieldTest, ThreadsDoNotChangeResults)
{
  const AttenuationField alone(blobVolume(), 0.5, 1 << 24);
  const AttenuationField together(blobVolume(), 0.5, 1 << 14);
  constexpr int kPoses = 24;
  const auto pose = [](int n) { return makePose({ 0.01 * (n % 6), 0.02, 0.0 }); };
  std::vector<cv::Mat> images(kPoses);
  tbb::parallel_for(0, kPoses, [&](int n) { images[n] = cast(together, pose(n)); });
  for (int n = 0; n < kPoses; ++n)
  {
    EXPECT_EQ(cv::norm(images[n], cast(alone, pose(n))), 0.0) << n;
  }
}

TEST(AttenuationFieldTest, RefusesBadInput)
{
  EXPECT_THROW(AttenuationField(nullptr, 0.5, 1000), std::invalid_argument);
  EXPECT_THROW(AttenuationField(blobVolume(), 0.0, 1000), std::invalid_argument);
  EXPECT_THROW(AttenuationField(blobVolume(), 0.5, 10), std::invalid_argument);
}
}  // namespace xray_tracking
