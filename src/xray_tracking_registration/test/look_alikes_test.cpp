#include "look_alikes.h"

#include <cstdlib>

#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "xray_tracking_core/volume/ct_content.h"

namespace xray_tracking
{
namespace
{
/// A rod of soft tissue along the patient's z with a bone at every multiple of the spacing [mm], which differ, as
/// vertebrae do, and bend to y; spacing 0: with a shaft, alike everywhere.
BodyModel column(double spacing)
{
  BodyModel bodies;
  VolumeGrid& grid = bodies.target.grid;
  grid.size = { 60, 60, 90 };
  grid.patient_from_index = Eigen::Translation3d(-59.0, -59.0, -89.0) * Eigen::Scaling(2.0);
  bodies.target.values.assign(grid.voxelCount(), 0.0f);
  for (int k = 0; k < 90; ++k)
  {
    for (int j = 0; j < 60; ++j)
    {
      for (int i = 0; i < 60; ++i)
      {
        const Eigen::Vector3d point = grid.patient_from_index * Eigen::Vector3d(i, j, k);
        const Eigen::Vector2d across(point.x(), point.y() - (spacing > 0.0 ? 0.15 * point.z() : 0.0));
        const double next = spacing > 0.0 ? std::round(point.z() / spacing) : 0.0;
        const double along = point.z() - spacing * next;
        float value = across.norm() < 45.0 ? 0.02f : 0.0f;
        if (spacing > 0.0 && across.norm() < 15.0 + std::fmod(std::abs(next), 2.0) && std::abs(along) < 0.3 * spacing)
        {
          value += 0.02f;
        }
        else if (spacing == 0.0 && across.norm() < 12.0)
        {
          value += across.norm() > 8.0 ? 0.04f : 0.01f;
        }
        bodies.target.values[grid.offset(i, j, k)] = value;
      }
    }
  }
  return bodies;
}

Eigen::AlignedBox3d cube(double edge)
{
  return { Eigen::Vector3d::Constant(-0.5 * edge), Eigen::Vector3d::Constant(0.5 * edge) };
}
}  // namespace

TEST(LookAlikes, AreOnePeriodAway)
{
  for (const double spacing : { 18.0, 26.0, 36.0 })
  {
    const std::vector<Eigen::Vector3d> found = lookAlikes(column(spacing), cube(40.0));
    ASSERT_EQ(found.size(), 2u) << "spacing " << spacing;
    for (int side = 0; side < 2; ++side)
    {
      // Found in cells of 2 mm, to the sides in steps of 4 mm.
      const double along = (side == 0 ? -1.0 : 1.0) * spacing;
      EXPECT_NEAR(found[side].z(), along, 2.0) << "spacing " << spacing;
      EXPECT_NEAR(found[side].y(), 0.15 * along, 4.0) << "spacing " << spacing;
      EXPECT_NEAR(found[side].x(), 0.0, 4.0) << "spacing " << spacing;
    }
  }
}

TEST(LookAlikes, AShaftHasNoneOfItsOwn)
{
  EXPECT_TRUE(lookAlikes(column(0.0), cube(40.0)).empty());
}

TEST(LookAlikes, ABoxBeyondTheCtIsCutOrHasNone)
{
  const BodyModel bodies = column(26.0);
  // Micrometres for millimetres: all of the CT, which looks like nothing else.
  EXPECT_TRUE(lookAlikes(bodies, cube(40000.0)).empty());
  EXPECT_TRUE(lookAlikes(bodies, cube(1e30)).empty());
  EXPECT_TRUE(lookAlikes(bodies, cube(40.0).translate(Eigen::Vector3d(0.0, 1e9, 0.0))).empty());
}

TEST(LookAlikes, OfTwoBodiesAreThoseOfTheWhole)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  const std::vector<Eigen::Vector3d> apart = lookAlikes(phantom.bodies(), phantom.targetBox());
  EXPECT_EQ(apart, lookAlikes(oneBody(phantom.ct()), phantom.targetBox()));
  ASSERT_EQ(apart.size(), 2u);
  // Vertebrae of a neck are 15 to 20 mm apart.
  EXPECT_NEAR(apart[0].z(), -17.5, 3.0);
  EXPECT_NEAR(apart[1].z(), 17.5, 3.0);
}

TEST(LookAlikes, InALumbarSpineAreTheNextLabels)
{
  if (std::getenv("XRAY_TRACKING_SHARED_DATA") == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  const std::string folder = std::string(std::getenv("XRAY_TRACKING_SHARED_DATA")) + "/lumbar_pelvis_ct/";
  const PatientCt ct = readPatientCt(folder + "ct.nii.gz");
  const CtVolume labels = readPatientCt(folder + "labels.nii.gz", CtContent::LABELS).volume;
  // L4 to L1; those above and below are cut or the sacrum.
  std::vector<Eigen::AlignedBox3d> boxes;
  std::vector<Eigen::Vector3d> centres;
  for (int label = 28; label <= 31; ++label)
  {
    Eigen::AlignedBox3d box;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    int count = 0;
    for (std::size_t n = 0; n < labels.hu.size(); ++n)
    {
      if (std::lround(labels.hu[n]) == label)
      {
        const auto& size = labels.grid.size;
        const int m = static_cast<int>(n);
        const Eigen::Vector3d point = labels.grid.patient_from_index *
                                      Eigen::Vector3d(m % size.x(), m / size.x() % size.y(), m / (size.x() * size.y()));
        box.extend(point);
        sum += point;
        ++count;
      }
    }
    boxes.push_back(box);
    centres.emplace_back(sum / count);
  }
  for (std::size_t n = 1; n + 1 < boxes.size(); ++n)
  {
    const BodyModel bodies = oneBody(ct.volume);
    const std::vector<Eigen::Vector3d> found = lookAlikes(bodies, boxes[n]);
    ASSERT_EQ(found.size(), 2u) << "label " << 28 + n;
    const bool up = centres[n + 1].z() > centres[n].z();
    // Within what keeps the next vertebra the nearest one; voxels have 3 mm, and labels are not all there is in a box.
    EXPECT_LT((found[up ? 1 : 0] - (centres[n + 1] - centres[n])).norm(), 7.0) << "label " << 28 + n;
    EXPECT_LT((found[up ? 0 : 1] - (centres[n - 1] - centres[n])).norm(), 7.0) << "label " << 28 + n;
  }
}
}  // namespace xray_tracking
