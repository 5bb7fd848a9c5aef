#include "xray_tracking_detector_simulator/anatomy.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "test_room.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
struct Lengths
{
  cv::Mat soft;
  cv::Mat bone;
};

Lengths materials(const Anatomy& anatomy, const ProjectionGeometry& geometry, const BodyPoses& poses)
{
  Lengths lengths;
  anatomy.materials(geometry, poses, lengths.soft, lengths.bone);
  return lengths;
}

double largest(const cv::Mat& a, const cv::Mat& b)
{
  return cv::norm(a, b, cv::NORM_INF);
}

RigidTransform motion(const TreatmentSetup& setup, const Twist& twist)
{
  return motionAbout(setup.room_from_patient * setup.targetCentre(), twist);
}

/// A block of soft tissue with a rod of bone, on a grid whose axes are swapped, mirrored and off the origin.
CtVolume makeBlock()
{
  CtVolume ct;
  ct.grid.size = { 60, 80, 70 };
  ct.grid.patient_from_index.linear() << 0.0, 1.5, 0.0, -1.5, 0.0, 0.0, 0.0, 0.0, 2.0;
  ct.grid.patient_from_index.translation() = Eigen::Vector3d(-60.0, 60.0, -65.0);
  ct.hu.assign(ct.grid.voxelCount(), -1000);
  for (int k = 0; k < ct.grid.size.z(); ++k)
  {
    for (int j = 0; j < ct.grid.size.y(); ++j)
    {
      for (int i = 0; i < ct.grid.size.x(); ++i)
      {
        const Eigen::Vector3d p = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        if (std::abs(p.x()) < 50.0 && std::abs(p.y() - 15.0) < 38.0)
        {
          const bool bone = std::abs(p.x() - 10.0) < 12.0 && std::abs(p.y() - 5.0) < 9.0;
          ct.hu[ct.grid.offset(i, j, k)] = static_cast<std::int16_t>(bone ? 900 : 30 + i % 7);
        }
      }
    }
  }
  return ct;
}

TEST(CtAnatomy, AgreesWithTheExactPhantomOnThePhantomsOwnCt)
{
  const TreatmentSetup setup = makeSetup();
  PhantomCtOptions options;
  options.noise_hu = 0.0;
  const CtAnatomy sampled(NeckPhantom().sampleCt(options), setup.target_box);
  const PhantomAnatomy exact;
  Twist twist;
  twist << 0.02, -0.01, 0.03, 4.0, -3.0, 2.0;
  BodyPoses poses{ motion(setup, twist) * setup.room_from_patient,
                   motion(setup, 0.9 * twist) * setup.room_from_patient };
  for (const ProjectionGeometry& geometry : setup.detectors)
  {
    const Lengths a = materials(exact, geometry, poses);
    const Lengths b = materials(sampled, geometry, poses);
    const cv::Mat exact_attenuation = kWaterAttenuation * a.soft + kBoneAttenuation * a.bone;
    const cv::Mat sampled_attenuation = kWaterAttenuation * b.soft + kBoneAttenuation * b.bone;
    double peak = 0.0;
    cv::minMaxLoc(exact_attenuation, nullptr, &peak);
    ASSERT_GT(peak, 1.0);
    const double rms = cv::norm(exact_attenuation, sampled_attenuation, cv::NORM_L2) / 128.0;
    const double mean = cv::mean(sampled_attenuation)[0] / cv::mean(exact_attenuation)[0];
    RecordProperty("rms_of_peak_" + geometry.name(), std::to_string(rms / peak));
    // Voxels of 1 mm blur edges, air below -1000 HU and the soft edge between the bodies, which the phantom parts
    // along its solids and the CT along a box, while they are 0.1 * twist apart: a few per cent of the peak.
    EXPECT_LT(rms, 0.03 * peak) << geometry.name();
    EXPECT_NEAR(mean, 1.0, 0.02) << geometry.name();
  }
}

TEST(CtAnatomy, SplittingTakesNothingAway)
{
  const TreatmentSetup setup = makeSetup();
  const CtVolume ct = makeBlock();
  const CtAnatomy anatomy(ct, setup.target_box);
  ScalarVolume soft;
  ScalarVolume bone;
  soft.grid = bone.grid = ct.grid;
  for (const std::int16_t hu : ct.hu)
  {
    const Materials m = materialsFromHu(hu);
    soft.values.push_back(static_cast<float>(m.soft));
    bone.values.push_back(static_cast<float>(m.bone));
  }
  for (const ProjectionGeometry& geometry : setup.detectors)
  {
    const Lengths sum = materials(anatomy, geometry, { setup.room_from_patient, setup.room_from_patient });
    Lengths whole;
    ShearWarpRenderer(soft).render(geometry, setup.room_from_patient, whole.soft);
    ShearWarpRenderer(bone).render(geometry, setup.room_from_patient, whole.bone);
    ASSERT_GT(cv::norm(whole.bone, cv::NORM_INF), 10.0);
    // Interpolation is linear; what is left is the error of three renderings of edges as hard as voxels allow, each
    // about 0.12 %.
    EXPECT_LT(cv::norm(sum.soft, whole.soft), 0.0025 * cv::norm(whole.soft));
    EXPECT_LT(cv::norm(sum.bone, whole.bone), 0.0025 * cv::norm(whole.bone));
  }
}

template <typename T>
std::unique_ptr<Anatomy> makeAnatomy(const TreatmentSetup& setup)
{
  if constexpr (std::is_same_v<T, CtAnatomy>)
  {
    return std::make_unique<CtAnatomy>(makeBlock(), setup.target_box);
  }
  else
  {
    return std::make_unique<PhantomAnatomy>();
  }
}

template <typename T>
class AnyAnatomy : public testing::Test
{
protected:
  TreatmentSetup setup_ = makeSetup();
  std::unique_ptr<Anatomy> anatomy_ = makeAnatomy<T>(setup_);
};

using Anatomies = testing::Types<PhantomAnatomy, CtAnatomy>;
TYPED_TEST_SUITE(AnyAnatomy, Anatomies);

TYPED_TEST(AnyAnatomy, MovingBothBodiesIsMovingTheDetectorTheOtherWay)
{
  const TreatmentSetup& setup = this->setup_;
  Twist twist;
  twist << 0.05, -0.03, 0.04, 6.0, -5.0, 4.0;
  const RigidTransform moved = motion(setup, twist);
  const RigidTransform pose = moved * setup.room_from_patient;
  for (const ProjectionGeometry& geometry : setup.detectors)
  {
    DetectorDescription description = geometry.description();
    const RigidTransform back = moved.inverse();
    description.source = back * description.source;
    description.origin = back * description.origin;
    description.x_direction = back.linear() * description.x_direction;
    description.y_direction = back.linear() * description.y_direction;
    const Lengths a = materials(*this->anatomy_, geometry, { pose, pose });
    const Lengths b = materials(*this->anatomy_, ProjectionGeometry::fromDescription(description),
                                { setup.room_from_patient, setup.room_from_patient });
    ASSERT_GT(cv::norm(a.soft, cv::NORM_INF), 50.0);
    // The same rays, computed another way: single precision. A ray that grazes an edge may fall on its other side.
    EXPECT_LT(cv::norm(a.soft, b.soft, cv::NORM_L1) / a.soft.total(), 0.01);
    EXPECT_LT(cv::norm(a.bone, b.bone, cv::NORM_L1) / a.bone.total(), 0.01);
  }
}

TYPED_TEST(AnyAnatomy, MovingTheTargetLeavesTheRestsImageAlone)
{
  const TreatmentSetup& setup = this->setup_;
  const RigidTransform& still = setup.room_from_patient;
  Twist twist = Twist::Zero();
  twist.tail<3>() << 5.0, 3.0, -4.0;
  const RigidTransform moved = motion(setup, twist) * still;
  for (const ProjectionGeometry& geometry : setup.detectors)
  {
    const Lengths before = materials(*this->anatomy_, geometry, { still, still });
    const Lengths after = materials(*this->anatomy_, geometry, { moved, still });
    const Lengths both = materials(*this->anatomy_, geometry, { moved, moved });
    const Lengths rest = materials(*this->anatomy_, geometry, { still, moved });
    // Superposition: target and rest add up, so that these two sums are of the same four parts.
    EXPECT_LT(largest(before.bone + both.bone, after.bone + rest.bone), 0.01);
    EXPECT_LT(largest(before.soft + both.soft, after.soft + rest.soft), 0.01);

    // Rays far from the target along room x, in which it reaches no further than C3 to C5 do: 40 mm of it, 58 mm on
    // the panel, 37 pixels from the centre of 63.5.
    cv::Mat change = cv::abs(after.bone - before.bone) + cv::abs(after.soft - before.soft);
    EXPECT_GT(cv::norm(change.colRange(50, 77), cv::NORM_INF), 2.0);
    EXPECT_EQ(cv::norm(change.colRange(0, 26), cv::NORM_INF), 0.0);
    EXPECT_EQ(cv::norm(change.colRange(101, 128), cv::NORM_INF), 0.0);
    // While the rest's motion shows there.
    EXPECT_GT(cv::norm(both.soft.colRange(0, 26), before.soft.colRange(0, 26), cv::NORM_INF), 0.5);
  }
}

TEST(CtAnatomy, ATissueWithoutBoneHasNone)
{
  const TreatmentSetup setup = makeSetup();
  CtVolume ct = makeBlock();
  std::replace_if(
      ct.hu.begin(), ct.hu.end(), [](std::int16_t hu) { return hu > 100; }, std::int16_t{ 40 });
  const Lengths lengths = materials(CtAnatomy(ct, setup.target_box), setup.detectors[0],
                                    { setup.room_from_patient, setup.room_from_patient });
  EXPECT_EQ(cv::norm(lengths.bone, cv::NORM_INF), 0.0);
  EXPECT_EQ(lengths.bone.size(), cv::Size(128, 128));
  EXPECT_GT(cv::norm(lengths.soft, cv::NORM_INF), 50.0);
}

TEST(CtAnatomy, ATargetOutsideTheCtIsRefused)
{
  const CtVolume ct = makeBlock();
  for (const double shift : { -1e12, -500.0, 500.0, 1e12 })
  {
    const Eigen::Vector3d centre(0.0, 0.0, shift);
    const Eigen::AlignedBox3d box(centre - Eigen::Vector3d::Constant(10.0), centre + Eigen::Vector3d::Constant(10.0));
    expectThrowNaming<std::invalid_argument>("target_box_mm", [&] { CtAnatomy(ct, box); });
  }
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
