#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "xray_tracking_core/projection/exact_projection.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"

namespace xray_tracking
{
inline VolumeGrid makeGrid(const Eigen::Vector3i& size, const Eigen::Vector3d& spacing,
                           const Eigen::Matrix3d& directions = Eigen::Matrix3d::Identity())
{
  VolumeGrid grid;
  grid.size = size;
  grid.patient_from_index.linear() = directions * spacing.asDiagonal();
  grid.patient_from_index.translation() =
      -grid.patient_from_index.linear() * (0.5 * (size.cast<double>() - Eigen::Vector3d::Ones()));
  return grid;
}

template <typename Value>
ScalarVolume fill(const VolumeGrid& grid, Value value)
{
  ScalarVolume volume{ grid, std::vector<float>(grid.voxelCount()) };
  for (int k = 0; k < grid.size.z(); ++k)
  {
    for (int j = 0; j < grid.size.y(); ++j)
    {
      for (int i = 0; i < grid.size.x(); ++i)
      {
        volume.values[grid.offset(i, j, k)] =
            static_cast<float>(value(grid.patient_from_index * Eigen::Vector3d(i, j, k)));
      }
    }
  }
  return volume;
}

inline double blob(const Eigen::Vector3d& point, const Eigen::Vector3d& centre, double sigma)
{
  return std::exp(-0.5 * (point - centre).squaredNorm() / (sigma * sigma));
}

/// Smooth, without symmetry, zero at the borders of a box of +-32 mm.
inline double blobs(const Eigen::Vector3d& point)
{
  return 0.03 * blob(point, { 3.0, -4.0, 5.0 }, 6.0) + 0.05 * blob(point, { -8.0, 6.0, -3.0 }, 4.0);
}

/// A panel seen from 1000 mm, off-centre by `offset` mm and tilted by `tilt` rad about its columns.
inline ProjectionGeometry makeGeometry(const Eigen::Vector2i& size, double pitch, double offset = 0.0,
                                       double tilt = 0.0)
{
  DetectorDescription description;
  description.name = "detector_a";
  description.image_size = size;
  description.pixel_pitch = Eigen::Vector2d::Constant(pitch);
  description.source = Eigen::Vector3d(0.0, 0.0, 1000.0);
  description.x_direction = Eigen::Vector3d(std::cos(tilt), 0.0, std::sin(tilt));
  description.y_direction = Eigen::Vector3d(0.0, -1.0, 0.0);
  description.origin = Eigen::Vector3d(offset, 0.0, -500.0) - 0.5 * pitch * (size.x() - 1) * description.x_direction -
                       0.5 * pitch * (size.y() - 1) * description.y_direction;
  return ProjectionGeometry::fromDescription(description);
}

inline RigidTransform makePose(const Eigen::Vector3d& rotation,
                               const Eigen::Vector3d& translation = Eigen::Vector3d::Zero())
{
  RigidTransform pose = RigidTransform::Identity();
  pose.linear() = rotationFromVector(rotation);
  pose.translation() = translation;
  return pose;
}

inline Ray rayInPatient(const ProjectionGeometry& geometry, const Eigen::Vector2d& pixel,
                        const RigidTransform& room_from_patient)
{
  const Ray ray = geometry.backProject(pixel);
  const RigidTransform patient_from_room = room_from_patient.inverse();
  return { patient_from_room * ray.source, patient_from_room.linear() * ray.direction };
}

template <typename Integrate>
cv::Mat castRays(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& pose,
                 Integrate integrate)
{
  cv::Mat image(pixels.size.y(), pixels.size.x(), CV_32FC1);
  for (int v = 0; v < image.rows; ++v)
  {
    for (int u = 0; u < image.cols; ++u)
    {
      const Eigen::Vector2d pixel = pixels.first + Eigen::Vector2d(u, v).cwiseProduct(pixels.step);
      image.at<float>(v, u) = static_cast<float>(integrate(rayInPatient(geometry, pixel, pose)));
    }
  }
  return image;
}

inline cv::Mat castTrilinear(const ScalarVolume& volume, const ProjectionGeometry& geometry, const PixelGrid& pixels,
                             const RigidTransform& pose)
{
  return castRays(geometry, pixels, pose, [&](const Ray& ray) { return integrateTrilinear(volume, ray); });
}

inline double relativeRms(const cv::Mat& image, const cv::Mat& reference)
{
  return cv::norm(image, reference) / cv::norm(reference);
}

/// Poses that take each axis, and none of them, along the central ray, from both sides.
inline std::vector<RigidTransform> poses()
{
  const double right = 0.5 * M_PI;
  const Eigen::Vector3d shift(4.0, -3.0, 6.0);
  return { makePose({ 0.0, 0.0, 0.0 }, shift),          makePose({ M_PI - 0.1, 0.05, 0.0 }, shift),
           makePose({ right + 0.05, 0.1, 0.0 }, shift), makePose({ 0.1, right, 0.0 }, shift),
           makePose({ -right, 0.0, 0.2 }, shift),       makePose({ 0.5 * right, 0.0, 0.0 }, shift),
           makePose({ 0.0, -0.5 * right, 0.3 }, shift), makePose({ 0.7, 0.6, 0.4 }, shift) };
}

/// All that this processor has.
inline std::vector<SimdLevel> levels()
{
  std::vector<SimdLevel> levels;
  for (const SimdLevel level : { SimdLevel::GENERIC, SimdLevel::AVX2, SimdLevel::AVX512 })
  {
    if (level <= bestSimdLevel())
    {
      levels.push_back(level);
    }
  }
  return levels;
}

/// Renderers for every level of vector instructions that the processor has.
class ShearWarpTest : public testing::TestWithParam<SimdLevel>
{
};

/// For INSTANTIATE_TEST_SUITE_P.
inline std::string levelName(const testing::TestParamInfo<SimdLevel>& info)
{
  return info.param == SimdLevel::GENERIC ? "generic" : info.param == SimdLevel::AVX2 ? "avx2" : "avx512";
}
}  // namespace xray_tracking
