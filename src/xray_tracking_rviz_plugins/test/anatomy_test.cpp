#include "anatomy.h"

#include <cmath>
#include <fstream>
#include <random>

#include <gtest/gtest.h>
#include <boost/filesystem.hpp>

#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
namespace
{
namespace fs = boost::filesystem;
const std::atomic<bool> kGoOn{ false };

class AnatomyTest : public testing::Test
{
protected:
  void SetUp() override { fs::create_directories(folder); }
  void TearDown() override { fs::remove_all(folder); }
  fs::path folder = fs::temp_directory_path() / fs::unique_path();
};

AnatomySource phantom()
{
  return { true, "", CtContent::FULL, NeckPhantom().targetBox() };
}

TEST_F(AnatomyTest, ThePhantomsBoneIsWhereItIs)
{
  const NeckPhantom neck;
  const Anatomy anatomy = makeAnatomy(phantom(), kGoOn);
  ASSERT_GT(anatomy.target.triangles.size(), 1000U);
  ASSERT_GT(anatomy.rest.triangles.size(), 1000U);
  // Bone begins within a voxel or two of the surface, on its inner side, against the closed form of the solids.
  const auto hu = [&](const Eigen::Vector3d& point) { return huFromMaterials(neck.at(point)); };
  for (const SurfaceMesh* mesh : { &anatomy.target, &anatomy.rest })
  {
    std::size_t right = 0;
    for (std::size_t i = 0; i < mesh->points.size(); ++i)
    {
      const Eigen::Vector3d point = mesh->points[i].cast<double>();
      const Eigen::Vector3d normal = mesh->normals[i].cast<double>();
      right += hu(point - 1.0 * normal) > 200.0 && hu(point + 1.0 * normal) < 200.0 ? 1 : 0;
    }
    EXPECT_GT(static_cast<double>(right) / static_cast<double>(mesh->points.size()), 0.85);
  }
  // The target is in the target's box, to what is within 3 mm of its bone.
  Eigen::AlignedBox3d box = neck.targetBox();
  box.min().array() -= 8.0;
  box.max().array() += 8.0;
  for (const Eigen::Vector3f& point : anatomy.target.points)
  {
    EXPECT_TRUE(box.contains(point.cast<double>())) << point.transpose();
  }
}

TEST_F(AnatomyTest, SlicesAreTheCt)
{
  const NeckPhantom neck;
  const Anatomy anatomy = makeAnatomy(phantom(), kGoOn);
  for (const CtSlice& slice : anatomy.slices)
  {
    // Through the target's centre.
    const Eigen::Vector3d centre =
        slice.origin + 0.5 * (slice.hu.cols - 1) * slice.column_step + 0.5 * (slice.hu.rows - 1) * slice.row_step;
    EXPECT_LT((centre - neck.targetBox().center()).norm(), 1e-9);
    EXPECT_NEAR(slice.column_step.norm(), slice.row_step.norm(), 1e-12);
    // Of HU, in the median: at edges voxels and closed form differ.
    std::vector<double> differences;
    for (int row = 40; row < slice.hu.rows - 40; row += 7)
    {
      for (int column = 40; column < slice.hu.cols - 40; column += 7)
      {
        const Eigen::Vector3d point = slice.origin + column * slice.column_step + row * slice.row_step;
        const int value = slice.hu.at<std::int16_t>(row, column);
        if (value > -1024)
        {
          differences.push_back(std::abs(value - huFromMaterials(neck.at(point))));
        }
      }
    }
    ASSERT_GT(differences.size(), 200U);
    std::nth_element(differences.begin(), differences.begin() + differences.size() / 2, differences.end());
    EXPECT_LT(differences[differences.size() / 2], 25.0);  // noise of 20 HU, averaged over eight voxels
  }
}

TEST(BodyTest, ThePatientIsKeptAndTheCouchIsNot)
{
  // A cylinder of soft tissue with lungs, 2 mm above a couch of two plates.
  CtVolume ct;
  ct.grid.size = { 160, 140, 40 };
  ct.grid.patient_from_index = Eigen::Translation3d(-150.0, -120.0, 30.0) * Eigen::Scaling(2.0, 2.0, 3.0);
  const auto in = [](const Eigen::Vector3d& p, double x, double a, double b)
  { return std::hypot((p.x() - x) / a, p.y() / b) < 1.0; };
  const auto couch = [](const Eigen::Vector3d& p)
  { return std::abs(p.x()) < 140.0 && (std::abs(p.y() - 93.0) < 2.1 || std::abs(p.y() - 120.0) < 2.1); };
  for (int k = 0; k < 40; ++k)
  {
    for (int j = 0; j < 140; ++j)
    {
      for (int i = 0; i < 160; ++i)
      {
        const Eigen::Vector3d p = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        const bool lung = in(p, -50.0, 35.0, 55.0) || in(p, 50.0, 35.0, 55.0);
        ct.hu.push_back(couch(p) ? 300 : in(p, 0.0, 120.0, 88.0) ? (lung ? -800 : 40) : -1000);
      }
    }
  }
  const ScalarVolume body = bodyOf(ct);
  const Eigen::Affine3d index_from_patient = body.grid.patient_from_index.inverse();
  const auto at = [&](double x, double y, double z)
  {
    const Eigen::Vector3i i = (index_from_patient * Eigen::Vector3d(x, y, z)).array().round().cast<int>();
    return body.values[body.grid.offset(i.x(), i.y(), i.z())] > 0.5F;
  };
  for (const double z : { 32.0, 90.0, 145.0 })
  {
    EXPECT_TRUE(at(0.0, 0.0, z));
    EXPECT_TRUE(at(0.0, -86.0, z));
    EXPECT_TRUE(at(118.0, 0.0, z));
    EXPECT_TRUE(at(88.0, 0.0, z));  // beside a lung
    EXPECT_FALSE(at(130.0, 93.0, z));
    EXPECT_FALSE(at(0.0, 120.0, z));
  }
}

TEST_F(AnatomyTest, ALinearVolumeIsSlicedExactly)
{
  CtVolume ct;
  ct.grid.size = { 40, 30, 20 };
  ct.grid.patient_from_index.linear() =
      Eigen::AngleAxisd(0.5, Eigen::Vector3d(1, 1, 0).normalized()).toRotationMatrix() *
      Eigen::Vector3d(1.0, -1.5, 3.0).asDiagonal();
  ct.grid.patient_from_index.translation() = Eigen::Vector3d(-10.0, 5.0, 20.0);
  const auto value = [](const Eigen::Vector3d& point)
  { return 100.0 + 3.0 * point.x() - 5.0 * point.y() + 4.0 * point.z(); };
  for (int k = 0; k < 20; ++k)
  {
    for (int j = 0; j < 30; ++j)
    {
      for (int i = 0; i < 40; ++i)
      {
        ct.hu.push_back(
            static_cast<std::int16_t>(std::lround(value(ct.grid.patient_from_index * Eigen::Vector3d(i, j, k)))));
      }
    }
  }
  const Eigen::Vector3d x = 0.7 * Eigen::Vector3d(1, 2, 2) / 3.0;
  const Eigen::Vector3d y = 0.7 * Eigen::Vector3d(2, 1, -2) / 3.0;
  const CtSlice slice = sliceOf(ct, ct.grid.centre(), x, y, { 15, 11 });
  for (int row = 0; row < 11; ++row)
  {
    for (int column = 0; column < 15; ++column)
    {
      const Eigen::Vector3d point = ct.grid.centre() + (column - 7) * x + (row - 5) * y;
      EXPECT_NEAR(slice.hu.at<std::int16_t>(row, column), value(point), 1.01);  // rounded twice
    }
  }
  EXPECT_EQ(sliceOf(ct, { 1000.0, 0.0, 0.0 }, x, y, { 3, 3 }).hu.at<std::int16_t>(1, 1), -1024);
}

TEST_F(AnatomyTest, WindowsClamp)
{
  const cv::Mat hu = (cv::Mat_<std::int16_t>(1, 5) << -1000, 50, 100, 150, 2000);
  const cv::Mat grey = windowed(hu, 100.0, 100.0);
  EXPECT_EQ(grey.at<std::uint8_t>(0), 0);
  EXPECT_EQ(grey.at<std::uint8_t>(1), 0);
  EXPECT_NEAR(grey.at<std::uint8_t>(2), 127.5, 0.6);
  EXPECT_EQ(grey.at<std::uint8_t>(3), 255);
  EXPECT_EQ(grey.at<std::uint8_t>(4), 255);
}

TEST_F(AnatomyTest, TheCacheGivesBackWhatWasMade)
{
  const Anatomy made = cachedAnatomy(phantom(), folder.string(), kGoOn);
  ASSERT_EQ(std::distance(fs::directory_iterator(folder), fs::directory_iterator{}), 1);
  const fs::path file = fs::directory_iterator(folder)->path();
  const Anatomy read = cachedAnatomy(phantom(), folder.string(), kGoOn);
  EXPECT_EQ(read.target.points, made.target.points);
  EXPECT_EQ(read.target.normals, made.target.normals);
  EXPECT_EQ(read.rest.triangles, made.rest.triangles);
  for (std::size_t i = 0; i < 3; ++i)
  {
    EXPECT_EQ(read.slices[i].row_step, made.slices[i].row_step);
    EXPECT_EQ(cv::countNonZero(read.slices[i].hu != made.slices[i].hu), 0);
  }
  // Cut off at any place, or with other bytes in it, it is made anew.
  const auto size = fs::file_size(file);
  for (const std::uintmax_t left : { std::uintmax_t{ 20 }, size - 1 })
  {
    fs::resize_file(file, left);
    EXPECT_EQ(cachedAnatomy(phantom(), folder.string(), kGoOn).rest.triangles, made.rest.triangles) << left;
    EXPECT_EQ(fs::file_size(file), size);
  }
  // A folder that cannot be is done without.
  EXPECT_EQ(cachedAnatomy(phantom(), (file / "no_folder").string(), kGoOn).rest.triangles, made.rest.triangles);
}

TEST_F(AnatomyTest, TheKeyHangsOnWhatCounts)
{
  const fs::path ct = folder / "ct.nrrd";
  std::ofstream(ct.string()) << "one";
  AnatomySource source{ false, ct.string(), CtContent::RECOGNISED,
                        Eigen::AlignedBox3d(Eigen::Vector3d::Zero(), Eigen::Vector3d::Ones()) };
  const std::string first = source.key();
  EXPECT_EQ(source.key(), first);
  AnatomySource other = source;
  other.target_box.max().x() += 1e-9;
  EXPECT_NE(other.key(), first);
  other = source;
  other.content = CtContent::LABELS;
  EXPECT_NE(other.key(), first);
  std::ofstream(ct.string()) << "other";
  EXPECT_NE(source.key(), first);
  const std::string second = source.key();
  fs::last_write_time(ct, fs::last_write_time(ct) + 2);
  EXPECT_NE(source.key(), second);
  source.ct_path = (folder / "nothing.nrrd").string();
  EXPECT_THROW(source.key(), std::runtime_error);
}

TEST(PointCovarianceTest, IsThatOfSampledPoses)
{
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  Eigen::Matrix<double, 6, 6> root;
  for (int i = 0; i < 36; ++i)
  {
    root(i / 6, i % 6) = (i / 6 < 3 ? 0.3 : 0.002) * normal(random);
  }
  const Eigen::Vector3d arm(120.0, -40.0, 75.0);
  Eigen::Matrix3d sampled = Eigen::Matrix3d::Zero();
  constexpr int kSamples = 20000;
  for (int s = 0; s < kSamples; ++s)
  {
    Eigen::Matrix<double, 6, 1> unit;
    for (int i = 0; i < 6; ++i)
    {
      unit[i] = normal(random);
    }
    const Eigen::Matrix<double, 6, 1> error = root * unit;
    const Eigen::Vector3d turn = error.tail<3>();
    const Eigen::Vector3d moved = error.head<3>() + Eigen::AngleAxisd(turn.norm(), turn.normalized()) * arm - arm;
    sampled += moved * moved.transpose() / kSamples;
  }
  const Eigen::Matrix3d covariance = pointCovariance(root * root.transpose(), arm);
  EXPECT_LT((covariance - sampled).norm(), 0.05 * sampled.norm());
}

TEST(ReadableScaleTest, MakesItLargeEnoughByARoundNumber)
{
  EXPECT_EQ(readableScale(20.0, 10.0), 1.0);
  EXPECT_EQ(readableScale(0.2, 10.0), 50.0);
  EXPECT_EQ(readableScale(0.06, 12.0), 200.0);
  EXPECT_EQ(readableScale(0.0, 10.0), 1000.0);
}
}  // namespace
}  // namespace xray_tracking
