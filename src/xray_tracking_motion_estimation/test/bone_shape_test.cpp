#include "xray_tracking_motion_estimation/bone_shape.h"

#include <cmath>
#include <filesystem>
#include <stdexcept>

#include <gtest/gtest.h>
#include <unistd.h>

#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
namespace
{
/// A block of bone in water, in a CT with anisotropic voxels that is turned about its z axis, and air around.
class BoneShape : public testing::Test
{
protected:
  BoneShape() : path_(testing::TempDir() + "bone_shape_" + std::to_string(getpid()) + ".nrrd")
  {
    CtVolume ct;
    ct.grid.size = { 100, 120, 60 };
    ct.grid.patient_from_index = Eigen::Translation3d(-60.0, 60.0, -40.0) *
                                 Eigen::AngleAxisd(-0.5 * M_PI, Eigen::Vector3d::UnitZ()) *
                                 Eigen::Scaling(1.2, 1.0, 1.5);
    ct.hu.assign(ct.grid.voxelCount(), -1000);
    for (int k = 0; k < ct.grid.size.z(); ++k)
    {
      for (int j = 0; j < ct.grid.size.y(); ++j)
      {
        for (int i = 0; i < ct.grid.size.x(); ++i)
        {
          const Eigen::Vector3d point = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
          if (point.head<2>().norm() < 45.0)
          {
            ct.hu[ct.grid.offset(i, j, k)] = bone_.contains(point) ? 700 : 0;
          }
        }
      }
    }
    writeCtVolume(ct, path_);
    setup_.ct_path = path_;
    setup_.target_box = Eigen::AlignedBox3d(Eigen::Vector3d(-25, -25, -25), Eigen::Vector3d(25, 25, 25));
  }
  ~BoneShape() override { std::filesystem::remove(path_); }

  const Eigen::AlignedBox3d bone_{ Eigen::Vector3d(-12, -6, -9), Eigen::Vector3d(18, 10, 15) };
  std::string path_;
  TreatmentSetup setup_;
};

TEST_F(BoneShape, OfALabelMapIsThatOfTheSameBone)
{
  const TargetShape shape = boneShape(setup_);
  CtVolume labels = readCtVolume(path_);
  for (std::int16_t& value : labels.hu)
  {
    value = static_cast<std::int16_t>(value == 700 ? 3 : 0);
  }
  writeCtVolume(labels, path_);
  const TargetShape same = boneShape(setup_);
  EXPECT_EQ(same.centroid, shape.centroid);
  EXPECT_EQ(same.moments, shape.moments);
}

TEST_F(BoneShape, IsThatOfABlock)
{
  const TargetShape shape = boneShape(setup_);
  // Faces are found to half a voxel, 0.75 mm.
  EXPECT_LT((shape.centroid - bone_.center()).norm(), 0.75);
  const Eigen::Vector3d deviations = bone_.sizes() / std::sqrt(12.0);  // of a uniform distribution
  EXPECT_LT((shape.moments.diagonal().cwiseSqrt() - deviations).cwiseAbs().maxCoeff(), 0.5);
  EXPECT_LT(std::abs(shape.moments(0, 1)) / (deviations.x() * deviations.y()), 0.02);
}

TEST_F(BoneShape, IsCutByTheTargetBox)
{
  setup_.target_box.max().x() = 0.0;
  EXPECT_NEAR(boneShape(setup_).centroid.x(), -6.0, 0.75);
}

TEST_F(BoneShape, NamesABoxWithoutBone)
{
  setup_.target_box = Eigen::AlignedBox3d(Eigen::Vector3d(30, 30, -5), Eigen::Vector3d(40, 40, 5));
  try
  {
    boneShape(setup_);
    FAIL();
  }
  catch (const std::runtime_error& error)
  {
    EXPECT_NE(std::string(error.what()).find("[30 30 -5]"), std::string::npos) << error.what();
  }
}

TEST(BoneShapeOfThePhantom, LiesInItsVertebra)
{
  TreatmentSetup setup;
  setup.target_box = NeckPhantom().targetBox();
  const TargetShape shape = boneShape(setup);
  EXPECT_TRUE(setup.target_box.contains(shape.centroid));
  // The neck is symmetric but for details; C4 is wider than it is high.
  EXPECT_LT(std::abs(shape.centroid.x()), 3.0);
  EXPECT_GT(shape.moments(0, 0), shape.moments(2, 2));
}
}  // namespace
}  // namespace xray_tracking
