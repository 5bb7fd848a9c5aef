#include "xray_tracking_core/volume/body_model.h"

#include <gtest/gtest.h>

#include "test_helpers.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector3d kBall(2.0, -3.0, 1.0);
constexpr double kRadius = 8.0;

/// A ball of bone in water, a smaller one next to it, air around; voxels of three different edges, a tilted grid.
CtVolume ballInWater()
{
  CtVolume ct;
  ct.grid.size = { 60, 56, 40 };
  ct.grid.patient_from_index = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1.0, 2.0, 3.0).normalized()) *
                               Eigen::Scaling(Eigen::Vector3d(1.0, 1.1, 1.6));
  ct.grid.patient_from_index.pretranslate(-ct.grid.centre());
  ct.hu.resize(ct.grid.voxelCount());
  for (int k = 0; k < ct.grid.size.z(); ++k)
  {
    for (int j = 0; j < ct.grid.size.y(); ++j)
    {
      for (int i = 0; i < ct.grid.size.x(); ++i)
      {
        const Eigen::Vector3d point = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        const bool bone = (point - kBall).norm() < kRadius || (point - kBall - Eigen::Vector3d(0, 14, 0)).norm() < 3.0;
        ct.hu[ct.grid.offset(i, j, k)] = bone ? 700 : point.norm() < 26.0 ? static_cast<int16_t>(i % 7 - 3) : -1000;
      }
    }
  }
  return ct;
}

Eigen::AlignedBox3d boxAroundBalls()
{
  return { kBall - Eigen::Vector3d(10, 10, 10), kBall + Eigen::Vector3d(10, 18, 10) };
}

/// Calls check(point, weight) for every voxel of the mask.
template <typename Check>
void forEachWeight(const TargetMask& mask, Check check)
{
  for (int k = 0; k < mask.grid.size.z(); ++k)
  {
    for (int j = 0; j < mask.grid.size.y(); ++j)
    {
      for (int i = 0; i < mask.grid.size.x(); ++i)
      {
        check(Eigen::Vector3d(mask.grid.patient_from_index * Eigen::Vector3d(i, j, k)),
              mask.values[mask.grid.offset(i, j, k)]);
      }
    }
  }
}

/// Weight that follows from the distance to the ball, which is of the large component alone.
void expectWeightsAroundBall(const TargetMask& mask, const TargetMaskOptions& options)
{
  const double edge = mask.grid.spacing().maxCoeff();  // the voxelised ball's surface is known no better
  int inside = 0;
  int between = 0;
  int outside = 0;
  forEachWeight(mask,
                [&](const Eigen::Vector3d& point, float weight)
                {
                  const double distance = (point - kBall).norm() - kRadius;
                  const auto expected = [&](double d)
                  {
                    const double x =
                        std::clamp((d - options.inner_mm) / (options.outer_mm - options.inner_mm), 0.0, 1.0);
                    return 1.0 - 3.0 * x * x + 2.0 * x * x * x;
                  };
                  EXPECT_LE(weight, expected(distance - edge) + 1e-6);
                  EXPECT_GE(weight, expected(distance + edge) - 1e-6);
                  ++(weight == 1.0f ? inside : weight == 0.0f ? outside : between);
                });
  EXPECT_GT(inside, 1000);
  EXPECT_GT(between, 1000);
  EXPECT_GT(outside, 100);
}
}  // namespace

TEST(TargetMask, BoneHasSoftEdgeAndLargestComponentAlone)
{
  TargetMaskOptions options;
  options.outer_mm = 9.0;
  options.closing_mm = 1.0;  // less than half the gap between the balls
  expectWeightsAroundBall(targetMaskFromBone(ballInWater(), boxAroundBalls(), options), options);
}

TEST(TargetMask, LabelMap)
{
  CtVolume labels = ballInWater();
  forEachWeight({ labels.grid, std::vector<float>(labels.hu.size()) },
                [&, n = std::size_t{ 0 }](const Eigen::Vector3d& point, float) mutable {
                  labels.hu[n++] = (point - kBall).norm() < kRadius ? 4 : point.x() > 0 ? 3 : 0;
                });
  TargetMaskOptions options;
  options.outer_mm = 9.0;
  expectWeightsAroundBall(targetMaskFromLabels(labels.grid, labels, 4, options), options);
  expectError<std::runtime_error>([&] { targetMaskFromLabels(labels.grid, labels, 5, options); }, { "label 5" });
  VolumeGrid other = labels.grid;
  other.patient_from_index.pretranslate(Eigen::Vector3d(0, 0, 0.5));
  expectError<std::runtime_error>([&] { targetMaskFromLabels(other, labels, 4, options); }, { "label map", "grid" });
  other = labels.grid;
  ++other.size.x();
  expectError<std::runtime_error>([&] { targetMaskFromLabels(other, labels, 4, options); },
                                  { "label map", std::to_string(other.size.x()) });
}

TEST(TargetMask, Box)
{
  const CtVolume ct = ballInWater();
  TargetMaskOptions options;
  options.outer_mm = 8.0;
  const Eigen::AlignedBox3d box = boxAroundBalls();
  const double edge = ct.grid.spacing().norm();
  int outside = 0;
  forEachWeight(targetMaskFromBox(ct.grid, box, options),
                [&](const Eigen::Vector3d& point, float weight)
                {
                  const double distance = box.exteriorDistance(point);
                  if (distance < options.inner_mm - edge)
                  {
                    EXPECT_EQ(weight, 1.0f);
                  }
                  if (distance > options.outer_mm + edge)
                  {
                    EXPECT_EQ(weight, 0.0f);
                    ++outside;
                  }
                });
  EXPECT_GT(outside, 100);
}

TEST(TargetMask, NamesWhatIsWrong)
{
  const CtVolume ct = ballInWater();
  const Eigen::AlignedBox3d far(Eigen::Vector3d(500, 0, 0), Eigen::Vector3d(520, 20, 20));
  expectError<std::runtime_error>([&] { targetMaskFromBone(ct, far); }, { "target box", "500", "no bone" });
  expectError<std::runtime_error>([&] { targetMaskFromBox(ct.grid, far); }, { "target box", "500", "no voxel" });
  TargetMaskOptions options;
  options.outer_mm = 2.0;
  expectError<std::invalid_argument>([&] { targetMaskFromBone(ct, boxAroundBalls(), options); }, { "outer_mm", "2" });
}

TEST(TargetMask, WrittenInTheCtsPlace)
{
  const TargetMask mask = targetMaskFromBone(ballInWater(), boxAroundBalls());
  const TemporaryFolder folder;
  // readCtVolume asks for Hounsfield units, which weights are not; one voxel of air makes them pass.
  TargetMask with_air = mask;
  with_air.values[0] = -1.0f;
  writeTargetMask(with_air, folder.path("air.mha"));
  const CtVolume read = readCtVolume(folder.path("air.mha"));
  EXPECT_EQ(read.grid.size, mask.grid.size);
  EXPECT_TRUE(read.grid.patient_from_index.isApprox(mask.grid.patient_from_index, 1e-6));
  for (std::size_t n = 1; n < mask.values.size(); ++n)
  {
    ASSERT_NEAR(read.hu[n], 1000.0f * mask.values[n], 0.51f);
  }
}

TEST(BodyModel, PartsAddUpToTheWhole)
{
  const CtVolume ct = ballInWater();
  const BodyModel bodies = splitBodies(ct, targetMaskFromBone(ct, boxAroundBalls()));
  ScalarVolume sum{ ct.grid, std::vector<float>(ct.hu.size(), 0.0f) };
  for (const ScalarVolume* body : { &bodies.target, &bodies.rest })
  {
    const Eigen::Vector3i first = (ct.grid.patient_from_index.inverse() * body->grid.patient_from_index.translation())
                                      .array()
                                      .round()
                                      .cast<int>();
    for (int k = 0; k < body->grid.size.z(); ++k)
    {
      for (int j = 0; j < body->grid.size.y(); ++j)
      {
        for (int i = 0; i < body->grid.size.x(); ++i)
        {
          sum.values[ct.grid.offset(first.x() + i, first.y() + j, first.z() + k)] +=
              body->values[body->grid.offset(i, j, k)];
        }
      }
    }
  }
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    ASSERT_FLOAT_EQ(sum.values[n], static_cast<float>(attenuationFromHu(ct.hu[n])));
  }
  EXPECT_LT(bodies.target.values.size(), ct.hu.size() / 2);
  EXPECT_LT(bodies.rest.values.size(), ct.hu.size());  // air at the corners is cropped
  EXPECT_LE(bodies.memory(), 3 * ct.hu.size() * sizeof(std::int16_t));
}

TEST(BodyModel, RefusesMaskOfAnotherGrid)
{
  const CtVolume ct = ballInWater();
  TargetMask mask = targetMaskFromBone(ct, boxAroundBalls());
  mask.grid.patient_from_index.translate(Eigen::Vector3d(0.5, 0.0, 0.0));
  EXPECT_THROW(splitBodies(ct, mask), std::invalid_argument);
  mask.grid.patient_from_index.translate(Eigen::Vector3d(100.5, 0.0, 0.0));
  EXPECT_THROW(splitBodies(ct, mask), std::invalid_argument);
}
}  // namespace xray_tracking
