#include <algorithm>
#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "phantom_samples.h"

namespace xray_tracking
{
namespace
{
using Eigen::Vector3d;

Materials materialsOf(const std::vector<Solid>& solids, const Vector3d& point)
{
  Materials sum;
  for (const Solid& solid : solids)
  {
    if (solid.contains(point))
    {
      sum.soft += solid.added().soft;
      sum.bone += solid.added().bone;
    }
  }
  return sum;
}

void forEachPoint(const Eigen::AlignedBox3d& box, double step, const std::function<void(const Vector3d&)>& function)
{
  for (double z = box.min().z(); z <= box.max().z(); z += step)
  {
    for (double y = box.min().y(); y <= box.max().y(); y += step)
    {
      for (double x = box.min().x(); x <= box.max().x(); x += step)
      {
        function({ x, y, z });
      }
    }
  }
}

TEST(NeckPhantom, HoundsfieldUnitsAreThoseOfABody)
{
  const auto check = [](const Vector3d& point)
  {
    const Materials m = phantom().at(point);
    const double hu = huFromMaterials(m);
    ASSERT_TRUE(hu >= -1000.001 && hu < 1700.0 && m.soft > -1e-9 && m.bone > -1e-9)
        << hu << " HU, soft " << m.soft << ", bone " << m.bone << " at " << point.transpose();
  };
  forEachPoint({ Vector3d::Constant(-99.0), Vector3d::Constant(99.0) }, 2.3, check);
  // The spine and what is near it, finely.
  forEachPoint({ Vector3d(-35.0, -45.0, -70.0), Vector3d(35.0, 45.0, 68.0) }, 0.9, check);
}

TEST(NeckPhantom, TargetMovesFreely)
{
  // Distance of the target's bone to the air of the throat.
  constexpr double kMargin = 3.0;
  int bone_points = 0;
  forEachPoint({ Vector3d(-35.0, -20.0, -35.0), Vector3d(35.0, 50.0, 35.0) }, 1.0,
               [&](const Vector3d& point)
               {
                 if (materialsOf(phantom().targetSolids(), point).bone < 0.02)
                 {
                   return;
                 }
                 ++bone_points;
                 const Materials rest = materialsOf(phantom().restSolids(), point);
                 ASSERT_NEAR(huFromMaterials(rest), 50.0, 50.0) << "not in soft tissue at " << point.transpose();
                 for (const Vector3d& way : { Vector3d(1, 0, 0), Vector3d(-1, 0, 0), Vector3d(0, 1, 0),
                                              Vector3d(0, -1, 0), Vector3d(0, -0.7, 0.7), Vector3d(0, -0.7, -0.7) })
                 {
                   ASSERT_GT(materialsOf(phantom().restSolids(), point + kMargin * way).soft, 0.3)
                       << "near air at " << point.transpose();
                 }
               });
  // Three vertebrae of some 10 cm^3.
  EXPECT_GT(bone_points, 20000);
  EXPECT_LT(bone_points, 45000);
}

TEST(NeckPhantom, TargetBoxIsAroundC4AndInTheSetupFile)
{
  const Eigen::AlignedBox3d& box = phantom().targetBox();
  EXPECT_TRUE(setup().target_box.min().isApprox(box.min()));
  EXPECT_TRUE(setup().target_box.max().isApprox(box.max()));
  // At these heights there is C4 alone.
  Eigen::AlignedBox3d bone;
  forEachPoint({ Vector3d(-45.0, -30.0, -4.0), Vector3d(45.0, 60.0, 4.0) }, 0.5,
               [&bone](const Vector3d& point)
               {
                 if (materialsOf(phantom().targetSolids(), point).bone > 0.05)
                 {
                   bone.extend(point);
                 }
               });
  EXPECT_TRUE(box.contains(bone));
  EXPECT_LT(bone.min().x() - box.min().x(), 2.0);
  EXPECT_LT(bone.min().y() - box.min().y(), 2.0);
  EXPECT_LT(box.max().x() - bone.max().x(), 2.0);
}

TEST(NeckPhantom, LineIntegralAgreesWithQuadrature)
{
  constexpr double kStep = 0.05;
  const RigidTransform patient_from_room = setup().room_from_patient.inverse();
  for (const ProjectionGeometry& geometry : setup().detectors)
  {
    for (int i = 0; i < 30; ++i)
    {
      Ray ray = geometry.backProject({ 20.0 + 97.0 * (i % 6), 35.0 + 101.0 * (i / 6) });
      ray.source = patient_from_room * ray.source;
      ray.direction = patient_from_room.linear() * ray.direction;
      // The phantom's reach along these rays: 2600 mm from the source, within 250 mm.
      Materials sum;
      for (double t = 2350.0 + 0.5 * kStep; t < 2850.0; t += kStep)
      {
        const Materials m = phantom().at(ray.source + t * ray.direction);
        sum.soft += kStep * m.soft;
        sum.bone += kStep * m.bone;
      }
      const Materials exact = phantom().lineIntegral(ray);
      // Each of some 60 crossed surfaces is misjudged by at most half a step of amounts of about 0.5, either way.
      EXPECT_NEAR(exact.soft, sum.soft, 0.1);
      EXPECT_NEAR(exact.bone, sum.bone, 0.1);
    }
  }
}

TEST(NeckPhantom, ImagesAgreeWithSingleRays)
{
  const RigidTransform room_from_rest =
      setup().room_from_patient * motionAbout({ 1.0, 2.0, 3.0 }, Twist::Constant(0.03));
  const RigidTransform room_from_target =
      setup().room_from_patient *
      motionAbout({ 0.0, 0.0, 0.0 }, (Twist() << 0.02, -0.04, 0.03, 7.0, -5.0, 3.0).finished());
  cv::Mat soft, bone;
  double most_bone = 0.0;
  for (const ProjectionGeometry& geometry : setup().detectors)
  {
    phantom().lineIntegrals(geometry, room_from_target, room_from_rest, soft, bone);
    ASSERT_EQ(soft.size(), cv::Size(512, 512));
    ASSERT_EQ(bone.type(), CV_32FC1);
    for (int row = 0; row < 512; row += 7)
    {
      for (int column = 0; column < 512; column += 11)
      {
        const Ray ray = geometry.backProject({ column, row });
        Materials sum;
        for (const bool target : { false, true })
        {
          const RigidTransform body_from_room = (target ? room_from_target : room_from_rest).inverse();
          for (const Solid& solid : target ? phantom().targetSolids() : phantom().restSolids())
          {
            const double length =
                solid.intersect({ body_from_room * ray.source, body_from_room.linear() * ray.direction }).length();
            sum.soft += length * solid.added().soft;
            sum.bone += length * solid.added().bone;
          }
        }
        ASSERT_NEAR(soft.at<float>(row, column), sum.soft, 1e-3) << column << ", " << row;
        ASSERT_NEAR(bone.at<float>(row, column), sum.bone, 1e-3) << column << ", " << row;
        most_bone = std::max(most_bone, sum.bone);
      }
    }
  }
  EXPECT_GT(most_bone, 15.0);
  // At rest the sum is what lineIntegral() gives.
  phantom().lineIntegrals(setup().detectors[0], setup().room_from_patient, setup().room_from_patient, soft, bone);
  Ray ray = setup().detectors[0].backProject({ 256, 300 });
  ray.source = setup().room_from_patient.inverse() * ray.source;
  ray.direction = setup().room_from_patient.linear().transpose() * ray.direction;
  EXPECT_NEAR(bone.at<float>(300, 256), phantom().lineIntegral(ray).bone, 1e-3);
}

TEST(NeckPhantom, NothingWhereThePhantomIsNot)
{
  RigidTransform away = setup().room_from_patient;
  away.pretranslate(Vector3d(2000.0, 0.0, 0.0));
  cv::Mat soft(512, 512, CV_32FC1, cv::Scalar(7.0)), bone;
  const uchar* const data = soft.data;
  phantom().lineIntegrals(setup().detectors[0], away, away, soft, bone);
  EXPECT_EQ(soft.data, data);
  EXPECT_EQ(cv::countNonZero(soft), 0);
  EXPECT_EQ(cv::countNonZero(bone), 0);
}

TEST(NeckPhantom, SolidsAroundTheSourceCount)
{
  // A source in the muscle at the left: half of the body is behind it.
  const ProjectionGeometry geometry =
      ProjectionGeometry::fromIntrinsics("inside", { 40, 30 }, { 30.0, 30.0 }, { 20.0, 15.0 },
                                         RigidTransform(Eigen::Translation3d(30.0, 20.0, 0.0)), 500.0);
  cv::Mat soft, bone;
  phantom().lineIntegrals(geometry, RigidTransform::Identity(), RigidTransform::Identity(), soft, bone);
  for (int row = 0; row < 30; ++row)
  {
    for (int column = 0; column < 40; ++column)
    {
      const Materials expected = phantom().lineIntegral(geometry.backProject({ column, row }));
      ASSERT_GT(expected.soft, 10.0);
      ASSERT_NEAR(soft.at<float>(row, column), expected.soft, 1e-3) << column << ", " << row;
      ASSERT_NEAR(bone.at<float>(row, column), expected.bone, 1e-3) << column << ", " << row;
    }
  }
}

TEST(NeckPhantom, AFlipShows)
{
  // Left and right exchanged, what one view sees is the other view's image upside down (their rows run against each
  // other about the sagittal plane).
  cv::Mat bone[2], soft;
  for (int i = 0; i < 2; ++i)
  {
    phantom().lineIntegrals(setup().detectors[i], setup().room_from_patient, setup().room_from_patient, soft, bone[i]);
  }
  cv::Mat other;
  cv::flip(bone[1], other, 0);
  // The same anatomy, so that these are the images to compare, but not the same image.
  EXPECT_GT(correlation(bone[0], other), 0.8);
  const cv::Rect target = projectedTargetRegion(setup(), setup().detectors[0]);
  EXPECT_LT(correlation(detail(bone[0])(target), detail(other)(target)), 0.95);
  for (const cv::Mat& image : bone)
  {
    for (const int axis : { 0, 1, -1 })
    {
      cv::flip(image, other, axis);
      EXPECT_LT(correlation(image, other), 0.95) << "axis " << axis;
    }
  }
}
}  // namespace
}  // namespace xray_tracking
