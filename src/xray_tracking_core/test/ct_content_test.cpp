#include "xray_tracking_core/volume/ct_content.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>

#include <gtest/gtest.h>

#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
/// Shells of cortical bone filled with marrow: of 14 mm about the middle, and of 5 mm beside it if asked for; in a
/// background.
CtVolume shells(std::int16_t background, bool second)
{
  CtVolume ct;
  ct.grid.size = { 60, 60, 60 };
  ct.grid.patient_from_index = Eigen::Translation3d(-29.5, -29.5, -29.5);
  const auto shell = [](const Eigen::Vector3d& from_centre, double radius, std::int16_t& hu)
  {
    const double distance = from_centre.norm();
    hu = distance > radius ? hu : static_cast<std::int16_t>(distance > radius - 2.0 ? 1200 : -40);
  };
  for (int k = 0; k < 60; ++k)
  {
    for (int j = 0; j < 60; ++j)
    {
      for (int i = 0; i < 60; ++i)
      {
        const Eigen::Vector3d point = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        std::int16_t hu = background;
        shell(point, 14.0, hu);
        if (second)
        {
          shell(point - Eigen::Vector3d(22.0, 0.0, 0.0), 5.0, hu);
        }
        ct.hu.push_back(hu);
      }
    }
  }
  return ct;
}

/// The same inside a ball of soft tissue of 25 mm in air.
CtVolume inTissue()
{
  CtVolume ct = shells(-1000, false);
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    const Eigen::Vector3d index(static_cast<double>(n % 60), static_cast<double>(n / 60 % 60),
                                static_cast<double>(n / 3600));
    if (ct.hu[n] == -1000 && (ct.grid.patient_from_index * index).norm() < 25.0)
    {
      ct.hu[n] = static_cast<std::int16_t>(40 + n % 7);
    }
  }
  return ct;
}

const Eigen::AlignedBox3d kBox(Eigen::Vector3d::Constant(-15.0), Eigen::Vector3d::Constant(15.0));
}  // namespace

TEST(CtContent, IsRecognised)
{
  EXPECT_EQ(recognisedContent(shells(-1000, false)), CtContent::BONE_IN_AIR);
  EXPECT_EQ(recognisedContent(shells(0, true)), CtContent::BONE_IN_AIR) << "a background of water";
  EXPECT_EQ(recognisedContent(shells(-3024, true)), CtContent::BONE_IN_AIR) << "a background of padding";
  EXPECT_EQ(recognisedContent(inTissue()), CtContent::FULL);
}

TEST(CtContent, OfSharedDataIsRecognised)
{
  const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (folder == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  const std::string data = folder;
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/thorax_ct")), CtContent::FULL);
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/lumbar_pelvis_ct/ct.nii.gz")), CtContent::FULL);
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/rtstruct/ct")), CtContent::FULL);
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/sequences/portal_real/ct.nii.gz")), CtContent::FULL);
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/sequences/wrist_real/ct.nii.gz")), CtContent::BONE_IN_AIR);
  EXPECT_EQ(recognisedContent(readCtVolume(data + "/sequences/knee_real/ct_both.nii.gz")), CtContent::BONE_IN_AIR);
}

TEST(CtContent, BoneInAirIsWhatItAddsToWater)
{
  const CtVolume ct = shells(-1000, false);
  const BodyModel bodies = bodiesOf(ct, targetMaskFromBone(ct, kBox), CtContent::RECOGNISED);
  EXPECT_TRUE(bodies.rest.values.empty()) << "nothing is outside of the target";
  double sum = 0.0;
  for (const float value : bodies.target.values)
  {
    sum += value;
  }
  // Only the bone counts: neither marrow, which has less than water, nor air.
  const auto bone = std::count(ct.hu.begin(), ct.hu.end(), 1200);
  EXPECT_NEAR(sum, 1.2 * kWaterAttenuation * static_cast<double>(bone), 1e-4 * sum);
}

TEST(CtContent, BodiesAreTwoWhereThereIsARest)
{
  const CtVolume ct = shells(-1000, true);
  EXPECT_FALSE(bodiesOf(ct, targetMaskFromBone(ct, kBox), CtContent::RECOGNISED).rest.values.empty());
  EXPECT_TRUE(bodiesOf(ct, std::nullopt, CtContent::RECOGNISED).rest.values.empty());
  const CtVolume full = inTissue();
  const BodyModel bodies = bodiesOf(full, targetMaskFromBone(full, kBox), CtContent::RECOGNISED);
  double sum = 0.0;
  for (const ScalarVolume* volume : { &bodies.target, &bodies.rest })
  {
    for (const float value : volume->values)
    {
      sum += value;
    }
  }
  double whole = 0.0;
  for (const float value : attenuationVolume(full).values)
  {
    whole += value;
  }
  EXPECT_NEAR(sum, whole, 1e-4 * whole);
}

TEST(CtContent, NamesAreNamed)
{
  for (const CtContent content : { CtContent::RECOGNISED, CtContent::FULL, CtContent::BONE_IN_AIR })
  {
    EXPECT_EQ(ctContentNamed(nameOf(content)), content);
  }
  try
  {
    ctContentNamed("bones");
    FAIL();
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find("bones"), std::string::npos);
  }
}
}  // namespace xray_tracking
