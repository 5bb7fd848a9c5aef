#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <itkImage.h>
#include <itkImageFileWriter.h>

#include "test_helpers.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
using HuImage = itk::Image<std::int16_t, 3>;

inline const Eigen::Vector3d kMiddle(12.0, -30.0, 250.0);

struct Ball
{
  Eigen::Vector3d from_middle;  ///< patient frame [mm]
  std::int16_t hu;
};
/// One ball left, posterior and superior of the middle, each of its own HU: every flip and permutation shows.
inline const std::vector<Ball> kBalls{
  { { 0, 0, 0 }, 40 }, { { 20, 0, 0 }, 300 }, { { 0, 18, 0 }, 600 }, { { 0, 0, 25 }, 900 }
};
constexpr double kBallRadius = 7.0;  // over twice the coarsest spacing

inline std::int16_t objectAt(const Eigen::Vector3d& point)
{
  for (const Ball& ball : kBalls)
  {
    if ((point - kMiddle - ball.from_middle).norm() < kBallRadius)
    {
      return ball.hu;
    }
  }
  return -1000;
}

/// The object sampled on a grid around its middle.
inline CtVolume sampled(const Eigen::Matrix3d& direction)
{
  CtVolume volume;
  volume.grid.size = { 50, 40, 36 };
  const Eigen::Vector3d spacing(1.5, 2.0, 2.5);
  volume.grid.patient_from_index.linear() = direction * spacing.asDiagonal();
  volume.grid.patient_from_index.translation() = kMiddle - volume.grid.centre();
  volume.hu.resize(volume.grid.voxelCount());
  for (int k = 0; k < volume.grid.size.z(); ++k)
  {
    for (int j = 0; j < volume.grid.size.y(); ++j)
    {
      for (int i = 0; i < volume.grid.size.x(); ++i)
      {
        volume.hu[volume.grid.offset(i, j, k)] = objectAt(volume.grid.patient_from_index * Eigen::Vector3d(i, j, k));
      }
    }
  }
  return volume;
}

inline int huAt(const CtVolume& volume, const Eigen::Vector3d& point)
{
  const Eigen::Vector3i index = (volume.grid.patient_from_index.inverse() * point).array().round().matrix().cast<int>();
  if (index.minCoeff() < 0 || (volume.grid.size - index).minCoeff() <= 0)
  {
    ADD_FAILURE() << "point " << point.transpose() << " is outside the volume";
    return 0;
  }
  return volume.hu[volume.grid.offset(index.x(), index.y(), index.z())];
}

inline void expectObject(const CtVolume& volume)
{
  ASSERT_EQ(volume.hu.size(), volume.grid.voxelCount());
  for (const Ball& ball : kBalls)
  {
    EXPECT_EQ(huAt(volume, kMiddle + ball.from_middle), ball.hu) << "at " << ball.from_middle.transpose();
  }
  EXPECT_EQ(huAt(volume, kMiddle - Eigen::Vector3d(20, 0, 0)), -1000);
  EXPECT_EQ(huAt(volume, kMiddle - Eigen::Vector3d(0, 18, 0)), -1000);
  EXPECT_EQ(huAt(volume, kMiddle - Eigen::Vector3d(0, 0, 25)), -1000);
}

inline void expectSameGrid(const VolumeGrid& grid, const VolumeGrid& expected)
{
  EXPECT_EQ(grid.size, expected.size);
  // The file formats hold single precision (NIfTI) or a dozen digits.
  EXPECT_TRUE(grid.patient_from_index.isApprox(expected.patient_from_index, 1e-6))
      << grid.patient_from_index.matrix() << "\nexpected\n"
      << expected.patient_from_index.matrix();
}

/// Direction matrices: columns are where i, j, k run to in LPS.
inline std::vector<Eigen::Matrix3d> directions()
{
  Eigen::Matrix3d flip = Eigen::Vector3d(1, -1, 1).asDiagonal();
  Eigen::Matrix3d permutation;
  permutation << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  Eigen::Matrix3d coronal;
  coronal << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  const Eigen::Matrix3d oblique = Eigen::AngleAxisd(0.6, Eigen::Vector3d(1, 2, -3).normalized()).toRotationMatrix();
  return { Eigen::Matrix3d::Identity(), flip, permutation, coronal, oblique, oblique * flip };
}

inline HuImage::Pointer itkImage(const CtVolume& volume)
{
  const auto image = HuImage::New();
  HuImage::RegionType region;
  HuImage::DirectionType direction;
  for (int axis = 0; axis < 3; ++axis)
  {
    region.SetSize(axis, volume.grid.size[axis]);
    for (int row = 0; row < 3; ++row)
    {
      direction(row, axis) = volume.grid.patient_from_index.linear().col(axis).normalized()[row];
    }
  }
  image->SetRegions(region);
  image->SetSpacing(volume.grid.spacing().data());
  image->SetOrigin(volume.grid.patient_from_index.translation().eval().data());
  image->SetDirection(direction);
  image->Allocate();
  std::copy(volume.hu.begin(), volume.hu.end(), image->GetBufferPointer());
  return image;
}

template <typename Image>
void writeByItk(Image* image, itk::ImageIOBase* format, const std::string& path, bool compressed = false)
{
  const auto writer = itk::ImageFileWriter<Image>::New();
  writer->SetImageIO(format);
  writer->SetFileName(path);
  writer->SetInput(image);
  writer->SetUseCompression(compressed);
  writer->Update();
}

/// Expects that readCtVolume refuses `path` with a message that has the path and all of `parts`.
inline void expectRefused(const std::string& path, std::vector<std::string> parts)
{
  SCOPED_TRACE(path);
  parts.insert(parts.begin(), path);
  expectError<std::runtime_error>([&] { readCtVolume(path); }, parts);
}

/// Keeps the given share of a file.
inline void truncate(const std::string& path, double share)
{
  const auto size = static_cast<double>(std::filesystem::file_size(path));
  std::filesystem::resize_file(path, static_cast<std::uintmax_t>(size * share));
}
}  // namespace xray_tracking
