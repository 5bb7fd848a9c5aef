#include "surface_mesh.h"

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

namespace xray_tracking
{
namespace
{
constexpr double kPi = 3.14159265358979323846;
const std::atomic<bool> kGoOn{ false };

/// Oblique, of different spacings, and left-handed.
VolumeGrid obliqueGrid(double fine = 1.0)
{
  VolumeGrid grid;
  grid.size = (Eigen::Array3d(90, 80, 50) / fine).cast<int>();
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.4, Eigen::Vector3d(1.0, 2.0, -0.5).normalized()).toRotationMatrix();
  grid.patient_from_index.linear() = turn * Eigen::Vector3d(0.9 * fine, -1.1 * fine, 1.7 * fine).asDiagonal();
  grid.patient_from_index.translation() = Eigen::Vector3d(-200.0, -60.0, -600.0);
  return grid;
}

/// Falls by 400 a millimetre through the sphere's surface, as a scanner's edge does.
ScalarVolume sphere(const VolumeGrid& grid, const Eigen::Vector3d& centre, double radius)
{
  ScalarVolume volume{ grid, std::vector<float>(grid.voxelCount()) };
  for (int k = 0; k < grid.size.z(); ++k)
  {
    for (int j = 0; j < grid.size.y(); ++j)
    {
      for (int i = 0; i < grid.size.x(); ++i)
      {
        const double depth = radius - (grid.patient_from_index * Eigen::Vector3d(i, j, k) - centre).norm();
        volume.values[grid.offset(i, j, k)] =
            static_cast<float>(1000.0 + std::max(-1000.0, std::min(1000.0, 400.0 * depth)));
      }
    }
  }
  return volume;
}

void expectSphere(const SurfaceMesh& mesh, const Eigen::Vector3d& centre, double radius)
{
  EXPECT_NEAR(mesh.area(), 4.0 * kPi * radius * radius, 0.02 * 4.0 * kPi * radius * radius);
  EXPECT_NEAR(mesh.volume(), 4.0 / 3.0 * kPi * std::pow(radius, 3), 0.02 * 4.0 / 3.0 * kPi * std::pow(radius, 3));
  ASSERT_EQ(mesh.normals.size(), mesh.points.size());
  double worst = 0.0;
  for (std::size_t i = 0; i < mesh.points.size(); ++i)
  {
    const Eigen::Vector3d arm = mesh.points[i].cast<double>() - centre;
    worst = std::max(worst, std::abs(arm.norm() - radius));
    EXPECT_GT(mesh.normals[i].cast<double>().dot(arm.normalized()), 0.9);  // outwards
  }
  EXPECT_LT(worst, 0.3);  // of voxels of 0.9 to 1.7 mm
}

TEST(SurfaceMeshTest, ASphereLiesWhereItIsAndIsAsLarge)
{
  const VolumeGrid grid = obliqueGrid();
  const Eigen::Vector3d centre = grid.centre() + Eigen::Vector3d(2.3, -1.7, 0.9);
  const SurfaceMesh mesh = isoSurface(sphere(grid, centre, 20.0), 1000.0F, 1000000, 0.0, kGoOn);
  EXPECT_GT(mesh.triangles.size(), 3000U);
  expectSphere(mesh, centre, 20.0);
}

TEST(SurfaceMeshTest, DecimationKeepsIt)
{
  const VolumeGrid grid = obliqueGrid();
  const SurfaceMesh mesh = isoSurface(sphere(grid, grid.centre(), 20.0), 1000.0F, 2000, 0.0, kGoOn);
  EXPECT_LE(mesh.triangles.size(), 2100U);
  EXPECT_GE(mesh.triangles.size(), 1500U);
  expectSphere(mesh, grid.centre(), 20.0);
}

TEST(SurfaceMeshTest, FineVoxelsAreAveragedAndTheSurfaceStays)
{
  const VolumeGrid grid = obliqueGrid(0.5);
  const SurfaceMesh mesh = isoSurface(sphere(grid, grid.centre(), 20.0), 1000.0F, 1000000, 0.0, kGoOn);
  expectSphere(mesh, grid.centre(), 20.0);
}

TEST(SurfaceMeshTest, WhatLeavesTheGridIsClosedThere)
{
  const VolumeGrid grid = obliqueGrid();
  // Its middle is in the grid's corner: an eighth of it is inside, up to a voxel of the border.
  const SurfaceMesh mesh =
      isoSurface(sphere(grid, grid.patient_from_index * Eigen::Vector3d::Zero(), 20.0), 1000.0F, 1000000, 0.0, kGoOn);
  const double eighth = kPi / 6.0 * std::pow(20.0, 3);
  EXPECT_GT(mesh.volume(), eighth);
  EXPECT_LT(mesh.volume(), kPi / 6.0 * std::pow(21.0, 3) * 1.1);
}

TEST(SurfaceMeshTest, SmallPiecesAreLeftOut)
{
  const VolumeGrid grid = obliqueGrid();
  ScalarVolume volume = sphere(grid, grid.centre(), 18.0);
  const ScalarVolume small = sphere(grid, grid.centre() + 25.0 * Eigen::Vector3d::UnitX(), 3.0);
  for (std::size_t i = 0; i < volume.values.size(); ++i)
  {
    volume.values[i] = std::max(volume.values[i], small.values[i]);
  }
  const double area = 4.0 * kPi * 9.0;
  expectSphere(isoSurface(volume, 1000.0F, 1000000, 1.3 * area, kGoOn), grid.centre(), 18.0);
  EXPECT_GT(isoSurface(volume, 1000.0F, 1000000, 0.7 * area, kGoOn).area(), 4.0 * kPi * 18.0 * 18.0 + 0.8 * area);
}

TEST(SurfaceMeshTest, IsSplitByTheMask)
{
  const VolumeGrid grid = obliqueGrid();
  const SurfaceMesh mesh = isoSurface(sphere(grid, grid.centre(), 20.0), 1000.0F, 1000000, 0.0, kGoOn);
  ScalarVolume mask{ grid, std::vector<float>(grid.voxelCount(), 0.0F) };
  const Eigen::Vector3d axis = grid.patient_from_index.linear().col(0).normalized();
  for (int k = 0; k < grid.size.z(); ++k)
  {
    for (int j = 0; j < grid.size.y(); ++j)
    {
      for (int i = 0; i < grid.size.x(); ++i)
      {
        const double height = (grid.patient_from_index * Eigen::Vector3d(i, j, k) - grid.centre()).dot(axis);
        mask.values[grid.offset(i, j, k)] = height > 10.0 ? 1.0F : 0.0F;
      }
    }
  }
  SurfaceMesh cap;
  SurfaceMesh rest;
  splitByMask(mesh, mask, cap, rest);
  EXPECT_EQ(cap.triangles.size() + rest.triangles.size(), mesh.triangles.size());
  // A cap of half the radius has a quarter of the sphere's surface; a row of triangles at its border more or less.
  EXPECT_NEAR(cap.area() / mesh.area(), 0.25, 0.03);
  for (const Eigen::Vector3f& point : cap.points)
  {
    EXPECT_GT((point.cast<double>() - grid.centre()).dot(axis), 9.0);
  }
}

TEST(SurfaceMeshTest, PiecesAreKeptWholeOrNot)
{
  const VolumeGrid grid = obliqueGrid();
  const Eigen::Vector3d axis = grid.patient_from_index.linear().col(0).normalized();
  const auto ball = [&](double along) { return sphere(grid, grid.centre() + along * axis, 10.0); };
  ScalarVolume both = ball(-15.0);
  const ScalarVolume other = ball(15.0);
  // Reaches from the left up to the middle of the right ball, but for a millimetre.
  ScalarVolume mask{ grid, std::vector<float>(grid.voxelCount()) };
  for (std::size_t i = 0; i < both.values.size(); ++i)
  {
    both.values[i] = std::max(both.values[i], other.values[i]);
    const Eigen::Vector3d index(static_cast<double>(i % grid.size.x()),
                                static_cast<double>(i / grid.size.x() % grid.size.y()),
                                static_cast<double>(i / grid.size.x() / grid.size.y()));
    mask.values[i] = (grid.patient_from_index * index - grid.centre()).dot(axis) < 14.0 ? 1.0F : 0.0F;
  }
  const SurfaceMesh mesh = isoSurface(both, 1000.0F, 1000000, 0.0, kGoOn);
  expectSphere(piecesWithin(mesh, mask), grid.centre() - 15.0 * axis, 10.0);
}

TEST(SurfaceMeshTest, NothingGivesNothing)
{
  const VolumeGrid grid = obliqueGrid();
  EXPECT_TRUE(isoSurface({}, 1.0F, 1000, 0.0, kGoOn).triangles.empty());
  EXPECT_TRUE(isoSurface({ grid, std::vector<float>(grid.voxelCount(), 0.0F) }, 1.0F, 1000, 0.0, kGoOn).points.empty());
  const std::atomic<bool> stop{ true };
  EXPECT_TRUE(isoSurface(sphere(grid, grid.centre(), 20.0), 1000.0F, 1000, 0.0, stop).triangles.empty());
}
}  // namespace
}  // namespace xray_tracking
