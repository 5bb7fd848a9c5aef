#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "drr_samples.h"

namespace xray_tracking
{
TEST_P(ShearWarpTest, RendersGridsAsTheWholePanelDoes)
{
  const ScalarVolume volume = fill(makeGrid({ 64, 64, 64 }, { 1, 1, 1 }), blobs);
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 200, 180 }, 0.5, 10.0);
  const RigidTransform pose = makePose({ 0.6, 0.4, 0.2 });
  cv::Mat whole;
  cv::Mat part;
  renderer.render(geometry, pose, whole);
  renderer.render(geometry, { { 31.0, 42.0 }, { 3.0, 2.0 }, { 40, 50 } }, pose, part);
  double error = 0.0;
  for (int v = 0; v < part.rows; ++v)
  {
    for (int u = 0; u < part.cols; ++u)
    {
      error = std::max<double>(error, std::abs(part.at<float>(v, u) - whole.at<float>(42 + 2 * v, 31 + 3 * u)));
    }
  }
  double largest;
  cv::minMaxLoc(whole, nullptr, &largest);
  EXPECT_LT(error, 3e-3 * largest);
  EXPECT_GT(cv::norm(part), 0.0);

  const PixelGrid bins = PixelGrid::binnedRegion({ 10, 20 }, { 43, 81 }, 4);
  EXPECT_EQ(bins.size, Eigen::Vector2i(10, 20));
  EXPECT_EQ(bins.first, Eigen::Vector2d(11.5, 21.5));
}

TEST_P(ShearWarpTest, NestsInOtherLoops)
{
  const ScalarVolume volume = fill(makeGrid({ 64, 64, 64 }, { 1, 1, 1 }), blobs);
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 120, 110 }, 0.6);
  std::vector<cv::Mat> alone(24);
  std::vector<cv::Mat> together(24);
  const auto pose = [](int n) { return makePose({ 0.1 * n, 0.05 * n, 0.0 }); };
  for (int n = 0; n < 24; ++n)
  {
    renderer.render(geometry, pose(n), alone[n]);
  }
  tbb::parallel_for(0, 24, [&](int n) { renderer.render(geometry, pose(n), together[n]); });
  for (int n = 0; n < 24; ++n)
  {
    EXPECT_EQ(cv::norm(alone[n], together[n], cv::NORM_INF), 0.0) << n;
  }
}

TEST_P(ShearWarpTest, GivesZeroWhereNothingIsCrossed)
{
  const ProjectionGeometry geometry = makeGeometry({ 40, 30 }, 1.0);
  cv::Mat image(30, 40, CV_32FC1, cv::Scalar(7));
  const ScalarVolume volume = fill(makeGrid({ 20, 20, 20 }, { 1, 1, 1 }), [](const Eigen::Vector3d&) { return 1.0; });
  const ShearWarpRenderer renderer(volume, GetParam());
  renderer.render(geometry, makePose({ 0, 0, 0 }, { 500, 0, 0 }), image);
  EXPECT_EQ(cv::norm(image), 0.0);
  renderer.render(geometry, makePose({ 0, 0, 0 }, { 0, 0, 1100 }), image);
  EXPECT_EQ(cv::norm(image), 0.0) << "behind the source";
  cv::Mat derivatives;
  renderer.renderWithDerivatives(geometry, PixelGrid::wholePanel(geometry), makePose({ 0.3, 0.2, 0 }, { 22, 0, 0 }),
                                 { 0, 0, 0 }, image, derivatives);
  EXPECT_GT(cv::norm(image), 0.0);
  EXPECT_EQ(image.at<float>(15, 1), 0.0f);
  EXPECT_EQ(cv::norm(derivatives.col(1)), 0.0);

  const ScalarVolume empty = fill(makeGrid({ 9, 9, 9 }, { 1, 1, 1 }), [](const Eigen::Vector3d&) { return 0.0; });
  image.setTo(3.0f);
  ShearWarpRenderer(empty, GetParam()).render(geometry, makePose({ 0, 0, 0 }), image);
  EXPECT_EQ(cv::norm(image), 0.0);
}

TEST_P(ShearWarpTest, HoldsTwoCopiesOfTheContentIn16Bits)
{
  const ScalarVolume volume = fill(makeGrid({ 128, 128, 128 }, { 1, 1, 1 }),
                                   [](const Eigen::Vector3d& p) { return p.cwiseAbs().maxCoeff() < 32.0 ? 1.0 : 0.0; });
  // 16 voxels of margin beside each row.
  EXPECT_LT(ShearWarpRenderer(volume, GetParam()).memory(), 2.05 * 2.0 * (64 + 16) * 64 * 64);
}

TEST_P(ShearWarpTest, RejectsBadInput)
{
  ScalarVolume volume = fill(makeGrid({ 9, 9, 9 }, { 1, 1, 1 }), [](const Eigen::Vector3d&) { return 1.0; });
  const ProjectionGeometry geometry = makeGeometry({ 40, 30 }, 1.0);
  const ShearWarpRenderer renderer(volume, GetParam());
  cv::Mat image;
  RigidTransform pose = makePose({ 0, 0, 0 });
  EXPECT_THROW(renderer.render(geometry, { { 0, 0 }, { 0, 1 }, { 3, 3 } }, pose, image), std::invalid_argument);
  EXPECT_THROW(renderer.render(geometry, { { 0, 0 }, { 1, 1 }, { 3, 0 } }, pose, image), std::invalid_argument);
  pose.translation().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(renderer.render(geometry, pose, image), std::invalid_argument);

  volume.values[5] = std::numeric_limits<float>::infinity();
  EXPECT_THROW(ShearWarpRenderer(volume, GetParam()), std::invalid_argument);
  volume.values.pop_back();
  EXPECT_THROW(ShearWarpRenderer(volume, GetParam()), std::invalid_argument);
  EXPECT_THROW(ShearWarpRenderer(ScalarVolume(), GetParam()), std::invalid_argument);
  ScalarVolume flat = fill(makeGrid({ 3, 3, 3 }, { 1, 1, 1 }), [](const Eigen::Vector3d&) { return 1.0; });
  flat.grid.patient_from_index.linear().col(2).setZero();
  EXPECT_THROW(ShearWarpRenderer(flat, GetParam()), std::invalid_argument);
}

INSTANTIATE_TEST_SUITE_P(Levels, ShearWarpTest, testing::ValuesIn(levels()), levelName);
}  // namespace xray_tracking
