#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "drr_samples.h"

namespace xray_tracking
{
TEST_P(ShearWarpTest, AgreesWithExactIntegrationInAnyPose)
{
  // White noise in a box is the worst case of any interpolation, smooth blobs the usual one: the tolerances are for a
  // mixture like a CT's, of which noise is 4 %.
  std::mt19937 generator(1);
  std::normal_distribution<double> noise(0.0, 0.0008);
  const auto tissue = [&](const Eigen::Vector3d& p) { return 0.02 + noise(generator) + blobs(p); };
  const ScalarVolume volume = fill(makeGrid({ 60, 64, 50 }, { 1.0, 1.0, 1.0 }), tissue);
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 512, 512 }, 0.4);
  for (const RigidTransform& pose : poses())
  {
    const PixelGrid pixels{ { 203.0, 211.0 }, { 1.0, 1.0 }, { 100, 60 } };
    cv::Mat image;
    renderer.render(geometry, pixels, pose, image);
    EXPECT_LT(relativeRms(image, castTrilinear(volume, geometry, pixels, pose)), 0.0015) << pose.matrix();
  }
}

TEST_P(ShearWarpTest, ShowsLayersSeenEdgeOn)
{
  // As vertebrae and discs in a lateral view, with steps of half the contrast from one voxel to the next: the kinks of
  // linear interpolation lie in line in all slices. A base plane of half a voxel's pitch is 0.5 % off.
  const auto layers = [](const Eigen::Vector3d& p) { return std::sin(0.8 * p.y()) > 0.0 ? 0.04 : 0.025; };
  const ScalarVolume volume = fill(makeGrid({ 60, 60, 60 }, { 1.0, 1.0, 1.0 }), layers);
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 512, 512 }, 0.4);
  const PixelGrid pixels{ { 203.0, 211.0 }, { 1.0, 1.0 }, { 40, 90 } };
  for (const double turn : { 0.0, 0.25 * M_PI, 0.5 * M_PI })
  {
    const RigidTransform pose = makePose({ 0.0, turn, 0.0 }, { 4.0, -3.0, 6.0 });
    cv::Mat image;
    renderer.render(geometry, pixels, pose, image);
    EXPECT_LT(relativeRms(image, castTrilinear(volume, geometry, pixels, pose)), 0.0025) << pose.matrix();
  }
}

TEST_P(ShearWarpTest, AgreesWithTheClosedFormOfBlobs)
{
  // Trilinear interpolation widens a blob's cross section by 1/6 voxel^2 an axis: of sigma 12 mm and 1 mm voxels by
  // 1.2e-3, the least that two interpolations may differ; rest is the renderer's.
  const double sigma = 12.0;
  const ScalarVolume volume = fill(makeGrid({ 121, 121, 121 }, { 1, 1, 1 }),
                                   [&](const Eigen::Vector3d& p) {
                                     return blob(p, { 3, -2, 1 }, sigma);
                                   });
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 60, 50 }, 1.0, 20.0, 0.3);
  for (const RigidTransform& pose : poses())
  {
    cv::Mat image;
    renderer.render(geometry, pose, image);
    const cv::Mat closed =
        castRays(geometry, PixelGrid::wholePanel(geometry), pose,
                 [&](const Ray& ray)
                 {
                   const double distance2 = (Eigen::Vector3d(3, -2, 1) - ray.source).cross(ray.direction).squaredNorm();
                   return sigma * std::sqrt(2.0 * M_PI) * std::exp(-0.5 * distance2 / (sigma * sigma));
                 });
    EXPECT_LT(relativeRms(image, closed), 0.002) << pose.matrix();
  }
}

TEST_P(ShearWarpTest, TakesAnyGrid)
{
  // Anisotropic voxels, sheared as by a tilted gantry, oblique and left-handed axes, thinner than a vector, and an axis
  // of one voxel.
  Eigen::Matrix3d left_handed = rotationFromVector({ 0.2, -0.3, 0.4 });
  left_handed.col(1) = -left_handed.col(1);
  Eigen::Matrix3d sheared = Eigen::Matrix3d::Identity();
  sheared(1, 2) = 0.3;
  // The smaller the volume, the more of it is the fall over one voxel at its border, whose kinks points of half a
  // voxel's pitch cannot show; a single voxel is nothing else.
  struct Case
  {
    VolumeGrid grid;
    double tolerance;
  };
  const std::vector<Case> cases = { { makeGrid({ 64, 64, 24 }, { 1.0, 1.0, 2.5 }, left_handed), 0.005 },
                                    { makeGrid({ 64, 64, 64 }, { 1.0, 1.0, 1.0 }, sheared), 0.005 },
                                    { makeGrid({ 5, 60, 40 }, { 1.0, 1.0, 1.0 }), 0.03 },
                                    { makeGrid({ 7, 6, 5 }, { 1.5, 1.5, 1.5 }, left_handed), 0.03 },
                                    { makeGrid({ 40, 1, 40 }, { 1.0, 1.0, 1.0 }), 0.06 },
                                    { makeGrid({ 1, 1, 1 }, { 2.0, 2.0, 2.0 }), 0.13 } };
  const ProjectionGeometry geometry = makeGeometry({ 90, 80 }, 0.5, 8.0, 0.2);
  for (const Case& test : cases)
  {
    const ScalarVolume volume = fill(test.grid, [](const Eigen::Vector3d& p) { return 0.01 + blobs(p); });
    const ShearWarpRenderer renderer(volume, GetParam());
    for (const RigidTransform& pose : poses())
    {
      cv::Mat image;
      renderer.render(geometry, pose, image);
      EXPECT_LT(relativeRms(image, castTrilinear(volume, geometry, PixelGrid::wholePanel(geometry), pose)),
                test.tolerance)
          << "size " << test.grid.size.transpose() << "\n"
          << pose.matrix();
    }
  }
}

TEST_P(ShearWarpTest, IsContinuousWhereTheMainAxisChanges)
{
  // At 45 degrees two axes are as good; the difference of the two must stay within the renderer's error.
  std::mt19937 generator(1);
  std::normal_distribution<double> noise(0.0, 0.0008);
  const ScalarVolume volume = fill(makeGrid({ 60, 60, 60 }, { 1, 1, 1 }),
                                   [&](const Eigen::Vector3d& p) { return 0.02 + noise(generator) + blobs(p); });
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 80, 80 }, 0.4);
  cv::Mat before;
  cv::Mat after;
  renderer.render(geometry, makePose({ 0.25 * M_PI - 1e-6, 0.0, 0.0 }), before);
  renderer.render(geometry, makePose({ 0.25 * M_PI + 1e-6, 0.0, 0.0 }), after);
  EXPECT_GT(cv::norm(before, after), 0.0) << "the axis has not changed";
  EXPECT_LT(relativeRms(before, after), 0.001);
}

TEST_P(ShearWarpTest, DividesWideCones)
{
  // A panel of 800 mm at 200 mm from the source: corner rays at 70 degrees to the central one.
  DetectorDescription description = makeGeometry({ 80, 80 }, 10.0).description();
  description.source.z() = -300.0;
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(description);
  const ScalarVolume volume = fill(makeGrid({ 64, 64, 64 }, { 2, 2, 2 }),
                                   [](const Eigen::Vector3d& p) {
                                     return blob(p, { 5, 0, 0 }, 16.0);
                                   });
  const ShearWarpRenderer renderer(volume, GetParam());
  for (const Eigen::Vector3d& place : { Eigen::Vector3d(0, 0, -420), Eigen::Vector3d(240, 200, -400) })
  {
    const RigidTransform pose = makePose({ 0.1, 0.2, 0.3 }, place);
    cv::Mat image;
    renderer.render(geometry, pose, image);
    EXPECT_LT(relativeRms(image, castTrilinear(volume, geometry, PixelGrid::wholePanel(geometry), pose)), 0.005);
  }
}

TEST_P(ShearWarpTest, DerivativesAreThoseOfTheClosedForm)
{
  struct Blob
  {
    double weight;
    Eigen::Vector3d centre;
    double sigma;
  };
  const std::vector<Blob> blobs = { { 1.0, { 3, -4, 5 }, 8.0 }, { 0.7, { -8, 6, -3 }, 7.0 } };
  const ScalarVolume volume = fill(makeGrid({ 100, 100, 100 }, { 1, 1, 1 }),
                                   [&](const Eigen::Vector3d& p)
                                   {
                                     return blobs[0].weight * blob(p, blobs[0].centre, blobs[0].sigma) +
                                            blobs[1].weight * blob(p, blobs[1].centre, blobs[1].sigma);
                                   });
  const auto closed_form = [&](const Ray& ray)
  {
    double sum = 0.0;
    for (const Blob& b : blobs)
    {
      const double distance2 = (b.centre - ray.source).cross(ray.direction).squaredNorm();
      sum += b.weight * b.sigma * std::sqrt(2.0 * M_PI) * std::exp(-0.5 * distance2 / (b.sigma * b.sigma));
    }
    return sum;
  };
  const ShearWarpRenderer renderer(volume, GetParam());
  const ProjectionGeometry geometry = makeGeometry({ 60, 50 }, 1.0, 15.0, 0.2);
  const PixelGrid pixels{ { 2.0, 3.0 }, { 2.0, 2.0 }, { 28, 22 } };
  const Eigen::Vector3d centre(6.0, -5.0, 9.0);
  for (const RigidTransform& pose : poses())
  {
    cv::Mat image;
    cv::Mat with_derivatives;
    cv::Mat derivatives;
    renderer.render(geometry, pixels, pose, image);
    renderer.renderWithDerivatives(geometry, pixels, pose, centre, with_derivatives, derivatives);
    EXPECT_LT(relativeRms(with_derivatives, image), 1e-5);
    ASSERT_EQ(derivatives.type(), CV_32FC(6));
    for (int n = 0; n < 6; ++n)
    {
      const double step = n < 3 ? 1e-3 : 1e-2;
      const auto moved = [&](double by)
      {
        Twist twist = Twist::Zero();
        twist[n] = by;
        return castRays(geometry, pixels, motionAbout(centre, twist) * pose, closed_form);
      };
      const cv::Mat expected = (moved(step) - moved(-step)) / (2.0 * step);
      cv::Mat derivative;
      cv::extractChannel(derivatives, derivative, n);
      // The trilinear volume has slopes that are constant between voxels: off a smooth slope by 1 / sqrt(12) voxel
      // times the curvature, of a blob of sigma 7 mm 4 %, and less as slices are seen at different places. Moving along
      // the central ray changes 40 times less than across, by the magnification alone.
      const double scale = std::max(cv::norm(expected), n < 3 ? 0.0 : 0.02 * cv::norm(image) / 7.0);
      EXPECT_LT(cv::norm(derivative, expected), 0.03 * scale) << "parameter " << n << "\n" << pose.matrix();
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Levels, ShearWarpTest, testing::ValuesIn(levels()), levelName);
}  // namespace xray_tracking
