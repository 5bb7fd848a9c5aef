#include "xray_tracking_core/volume/neck_phantom.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "test_helpers.h"
#include "xray_tracking_core/projection/drr_renderer.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
namespace
{
using Eigen::Vector3d;

const NeckPhantom& phantom()
{
  static const NeckPhantom neck;
  return neck;
}

const TreatmentSetup& setup()
{
  static const TreatmentSetup setup =
      loadTreatmentSetup((std::filesystem::path(__FILE__).parent_path() / "../config/phantom_neck.yaml").string());
  return setup;
}

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

/// Mean of a CT around a patient point.
double meanHu(const CtVolume& ct, const Vector3d& centre, const Vector3d& half_size)
{
  const Eigen::Affine3d index_from_patient = ct.grid.patient_from_index.inverse();
  const Eigen::Vector3i low = (index_from_patient * (centre - half_size)).array().round().cast<int>();
  const Eigen::Vector3i high = (index_from_patient * (centre + half_size)).array().round().cast<int>();
  double sum = 0.0;
  for (int k = low.z(); k <= high.z(); ++k)
  {
    for (int j = low.y(); j <= high.y(); ++j)
    {
      for (int i = low.x(); i <= high.x(); ++i)
      {
        sum += ct.hu.at(ct.grid.offset(i, j, k));
      }
    }
  }
  return sum / (high - low + Eigen::Vector3i::Ones()).prod();
}

double correlation(const cv::Mat& a, const cv::Mat& b)
{
  cv::Mat result;
  cv::matchTemplate(a, b, result, cv::TM_CCOEFF_NORMED);
  return result.at<float>(0, 0);
}

/// What is smaller than about 10 mm in the patient.
cv::Mat detail(const cv::Mat& image)
{
  cv::Mat smooth;
  cv::GaussianBlur(image, smooth, cv::Size(), 12.0);
  return image - smooth;
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

TEST(NeckPhantomCt, TissuesHaveTheirHoundsfieldUnits)
{
  const CtVolume ct = phantom().sampleCt({});
  ASSERT_EQ(ct.hu.size(), 200u * 200u * 160u);
  EXPECT_LT(ct.grid.centre().norm(), 1e-9);
  EXPECT_TRUE(ct.grid.spacing().isApprox(Vector3d(1.0, 1.0, 1.25)));
  // Noise of 20 HU over 100 voxels and more: 2 HU.
  EXPECT_NEAR(meanHu(ct, { 35.0, 35.0, 0.0 }, { 5.0, 5.0, 5.0 }), 50.0, 5.0) << "muscle";
  EXPECT_NEAR(meanHu(ct, { 0.8, -16.5, 0.0 }, { 5.0, 1.0, 3.0 }), -1000.0, 25.0) << "pharynx, clipped at -1024";
  EXPECT_NEAR(meanHu(ct, { 90.0, 90.0, 0.0 }, { 5.0, 5.0, 5.0 }), -1000.0, 25.0) << "air";
  EXPECT_NEAR(meanHu(ct, { 0.0, 0.9, -9.0 }, { 4.0, 3.0, 0.5 }), 95.0, 12.0) << "disc C4/5";
  EXPECT_NEAR(meanHu(ct, { 0.0, -0.5, 0.0 }, { 4.0, 4.0, 3.0 }), 300.0, 60.0) << "marrow and trabeculae of C4";
}

TEST(NeckPhantomCt, VoxelsAreAveragesOverTheirVolume)
{
  PhantomCtOptions options;
  options.noise_hu = 0.0;
  options.size = { 60, 90, 30 };
  const CtVolume ct = phantom().sampleCt(options);
  std::mt19937 generator(3);
  double squares = 0.0, sum = 0.0;
  int n = 0;
  while (n < 120)
  {
    const Eigen::Vector3i voxel(generator() % 60, generator() % 90, generator() % 30);
    const Vector3d centre = ct.grid.patient_from_index * voxel.cast<double>();
    constexpr int kPoints = 12;
    double mean = 0.0, low = 1e9, high = -1e9;
    for (int i = 0; i < kPoints * kPoints * kPoints; ++i)
    {
      const Eigen::Array3d share(i % kPoints, i / kPoints % kPoints, i / (kPoints * kPoints));
      const Vector3d offset = ((share + 0.5) / kPoints - 0.5) * options.spacing.array();
      const double hu = huFromMaterials(phantom().at(centre + offset));
      mean += hu / (kPoints * kPoints * kPoints);
      low = std::min(low, hu);
      high = std::max(high, hu);
    }
    if (high - low < 200.0)
    {
      continue;  // no edge: nothing to average
    }
    const double error = ct.hu[ct.grid.offset(voxel.x(), voxel.y(), voxel.z())] - mean;
    // The worst that 4 lines across a voxel can do: an eighth of the contrast, and 1/24 of it is the reference's own.
    EXPECT_LT(std::abs(error), (1.0 / 8.0 + 1.0 / 24.0) * (high - low) + 1.0) << centre.transpose();
    sum += error;
    squares += error * error;
    ++n;
  }
  EXPECT_LT(std::sqrt(squares / n), 20.0);
  EXPECT_LT(std::abs(sum / n), 4.0);
}

TEST(NeckPhantomCt, NoiseIsWhiteAndSeeded)
{
  PhantomCtOptions options;
  options.size = { 60, 60, 20 };
  const CtVolume first = phantom().sampleCt(options);
  EXPECT_EQ(phantom().sampleCt(options).hu, first.hu);
  options.seed = 2;
  const CtVolume second = phantom().sampleCt(options);
  options.noise_hu = 0.0;
  const CtVolume clean = phantom().sampleCt(options);
  // Where the scanner's lower limit does not cut the noise off.
  double sum = 0.0, squares = 0.0, between_seeds = 0.0, between_slices = 0.0;
  int n = 0;
  const std::size_t slice = clean.grid.offset(0, 0, 1);
  for (std::size_t i = 0; i + slice < clean.hu.size(); ++i)
  {
    if (clean.hu[i] > -900 && clean.hu[i + slice] > -900)
    {
      const double noise = first.hu[i] - clean.hu[i];
      sum += noise;
      squares += noise * noise;
      between_seeds += noise * (second.hu[i] - clean.hu[i]);
      between_slices += noise * (first.hu[i + slice] - clean.hu[i + slice]);
      ++n;
    }
  }
  ASSERT_GT(n, 50000);
  // Five standard errors of n values.
  const double five = 5.0 / std::sqrt(n);
  EXPECT_NEAR(sum / n, 0.0, 20.0 * five);
  EXPECT_NEAR(std::sqrt(squares / n), 20.0, 20.0 * five);
  EXPECT_NEAR(between_seeds / squares, 0.0, five);
  EXPECT_NEAR(between_slices / squares, 0.0, five);
}

TEST(NeckPhantomCt, SliceThicknessBlursAlongZ)
{
  // The hard palate is a plate of 650 HU at z = 58.4 to 61.6 mm, in muscle of 50 HU.
  PhantomCtOptions options;
  options.size = { 5, 130, 260 };
  options.spacing = { 1.0, 1.0, 0.5 };
  options.noise_hu = 0.0;
  for (const double thickness : { 0.5, 1.25, 3.0, 5.0 })
  {
    options.slice_thickness = thickness;
    const CtVolume ct = phantom().sampleCt(options);
    for (double z = 54.25; z < 64.9; z += 0.5)
    {
      const double overlap = std::min(z + 0.5 * thickness, 61.6) - std::max(z - 0.5 * thickness, 58.4);
      const double expected = 50.0 + 600.0 * std::max(0.0, overlap) / thickness;
      // Four lines over the thickness: each of two edges is off by up to an eighth.
      EXPECT_NEAR(meanHu(ct, { 0.0, -56.5, z }, { 1.0, 2.0, 0.0 }), expected, 2.0 * 600.0 / 8.0 + 1.0)
          << "z " << z << ", thickness " << thickness;
    }
    const double peak = meanHu(ct, { 0.0, -56.5, 60.25 }, { 1.0, 2.0, 0.0 });
    EXPECT_NEAR(peak, thickness < 3.0 ? 650.0 : 50.0 + 600.0 * 3.0 / thickness, 61.0) << "thickness " << thickness;
  }
}

TEST(NeckPhantomCt, RadiographsOfItAgreeWithTheExactOnes)
{
  PhantomCtOptions options;
  options.noise_hu = 0.0;  // the noise of air, of which only the upper half attenuates, would be a bias
  const auto volume = std::make_shared<const ScalarVolume>(attenuationVolume(phantom().sampleCt(options)));
  const auto renderer = makeJosephRenderer(volume);
  for (const ProjectionGeometry& geometry : setup().detectors)
  {
    cv::Mat drr, soft, bone;
    renderer->render(geometry, setup().room_from_patient, drr);
    phantom().lineIntegrals(geometry, setup().room_from_patient, setup().room_from_patient, soft, bone);
    const cv::Mat exact = kWaterAttenuation * soft + kBoneAttenuation * bone;
    const cv::Rect target = projectedTargetRegion(setup(), geometry);
    const cv::Mat difference = drr(target) - exact(target);
    cv::Scalar mean, deviation;
    cv::meanStdDev(difference, mean, deviation);
    const double level = cv::mean(exact(target))[0];
    // Edges differ by the blur of 1 mm voxels, which does not change the mean.
    EXPECT_LT(std::abs(mean[0]) / level, 0.003) << geometry.name();
    EXPECT_LT(deviation[0] / level, 0.015) << geometry.name();
    EXPECT_GT(correlation(detail(drr)(target), detail(exact)(target)), 0.9) << geometry.name();
  }
}

TEST(NeckPhantomCt, RefusesBadOptions)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refuses = [](const std::string& option, const std::function<void(PhantomCtOptions&)>& spoil)
  {
    PhantomCtOptions options;
    spoil(options);
    expectError<std::invalid_argument>([&options] { phantom().sampleCt(options); }, { option, "expected" });
  };
  refuses("size", [](PhantomCtOptions& o) { o.size.y() = 0; });
  refuses("size", [](PhantomCtOptions& o) { o.size.z() = 100000; });
  refuses("spacing", [](PhantomCtOptions& o) { o.spacing.x() = -1.0; });
  refuses("spacing", [nan](PhantomCtOptions& o) { o.spacing.z() = nan; });
  refuses("slice_thickness", [](PhantomCtOptions& o) { o.slice_thickness = 0.0; });
  refuses("noise_hu", [](PhantomCtOptions& o) { o.noise_hu = -1.0; });
  refuses("noise_hu", [nan](PhantomCtOptions& o) { o.noise_hu = nan; });
}
}  // namespace
}  // namespace xray_tracking
