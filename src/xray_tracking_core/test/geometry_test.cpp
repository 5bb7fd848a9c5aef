#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Dense>
#include <unsupported/Eigen/MatrixFunctions>

#include "test_helpers.h"
#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
namespace
{
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Tilted, off-centre, not square in pixels or pitch: nothing cancels by symmetry.
DetectorDescription obliqueDescription()
{
  const Eigen::Matrix3d axes =
      (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(-0.4, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  DetectorDescription description;
  description.name = "oblique";
  description.image_size = { 300, 200 };
  description.pixel_pitch = { 0.4, 0.7 };
  description.x_direction = axes.col(0);
  description.y_direction = axes.col(1);
  description.source = { 120.0, -300.0, 450.0 };
  description.origin = description.source + axes * Eigen::Vector3d(-90.0, -20.0, 1200.0);
  return description;
}

std::vector<Eigen::Vector3d> randomPoints(const ProjectionGeometry& geometry)
{
  std::mt19937 generator(4);
  std::uniform_real_distribution<double> across(-200.0, 200.0);
  std::uniform_real_distribution<double> along(200.0, 1400.0);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 50; ++i)
  {
    points.push_back(geometry.roomFromOptical() *
                     Eigen::Vector3d(across(generator), across(generator), along(generator)));
  }
  return points;
}

std::vector<ProjectionGeometry> loadPreset(const std::string& name)
{
  return loadDetectors((std::filesystem::path(__FILE__).parent_path() / "../config/geometry" / name).string());
}

TEST(RigidTransform, RotationIsTheMatrixExponential)
{
  for (const Eigen::Vector3d& vector :
       { Eigen::Vector3d(0.3, -0.2, 0.5), Eigen::Vector3d(1e-9, 2e-9, -1e-9), Eigen::Vector3d(0.0, 3.1, 0.2) })
  {
    const Eigen::Matrix3d generator = skew(vector);
    EXPECT_LT((rotationFromVector(vector) - generator.exp()).norm(), 1e-13);
    EXPECT_LT((vectorFromRotation(rotationFromVector(vector)) - vector).norm(), 1e-12);
  }
  EXPECT_EQ(rotationFromVector(Eigen::Vector3d::Zero()), Eigen::Matrix3d::Identity());
  EXPECT_EQ(vectorFromRotation(Eigen::Matrix3d::Identity()), Eigen::Vector3d::Zero());
  // Beyond half a turn the vector comes back the other way round.
  EXPECT_LE(vectorFromRotation(rotationFromVector({ 0.0, 3.5, 0.0 })).norm(), M_PI);
  EXPECT_EQ(skew({ 1.0, 2.0, 3.0 }) * Eigen::Vector3d(-4.0, 0.5, 2.0),
            Eigen::Vector3d(1.0, 2.0, 3.0).cross(Eigen::Vector3d(-4.0, 0.5, 2.0)));
}

TEST(RigidTransform, MotionRotatesAboutItsCentre)
{
  const Eigen::Vector3d centre(10.0, 200.0, -550.0);
  Twist twist;
  twist << 0.02, -0.03, 0.05, 1.0, -2.0, 3.0;
  const RigidTransform motion = motionAbout(centre, twist);
  EXPECT_LT((motion * centre - centre - twist.tail<3>()).norm(), 1e-12);
  EXPECT_LT((motion.linear() - rotationFromVector(twist.head<3>())).norm(), 1e-15);
  EXPECT_LT((twistAbout(centre, motion) - twist).norm(), 1e-12);
  EXPECT_NEAR(rotationAngle(motion), twist.head<3>().norm(), 1e-12);
}

TEST(RigidTransform, FromQuaternion)
{
  const RigidTransform transform = makeRigidTransform({ 1.0, 2.0, 3.0 }, { 1.0005, 0.0, 0.0, 0.0 });
  EXPECT_LT((transform.matrix() - RigidTransform(Eigen::Translation3d(1.0, 2.0, 3.0)).matrix()).norm(), 1e-15);
  // A quarter turn about z takes x to y.
  const RigidTransform quarter = makeRigidTransform({ 0.0, 0.0, 0.0 }, { std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5) });
  EXPECT_LT((quarter * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(), 1e-15);

  const auto make = [](const Eigen::Vector3d& translation, const Eigen::Quaterniond& rotation)
  { return [=] { makeRigidTransform(translation, rotation); }; };
  expectError<std::invalid_argument>(make({ 0.0, kNan, 0.0 }, { 1.0, 0.0, 0.0, 0.0 }), { "translation", "nan" });
  expectError<std::invalid_argument>(make({ 0.0, 0.0, 0.0 }, { kNan, 0.0, 0.0, 0.0 }), { "quaternion", "nan" });
  expectError<std::invalid_argument>(make({ 0.0, 0.0, 0.0 }, { 1.01, 0.0, 0.0, 0.0 }), { "unit norm", "1.01" });
}

TEST(RigidTransform, IsRigid)
{
  RigidTransform transform = motionAbout({ 1.0, 2.0, 3.0 }, Twist::Constant(0.3));
  EXPECT_TRUE(isRigid(transform));
  transform.translation().x() = kNan;
  EXPECT_FALSE(isRigid(transform));
  transform = RigidTransform::Identity();
  transform.linear() *= 1.0 + 1e-5;
  EXPECT_FALSE(isRigid(transform));
  transform.linear() = Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal();
  EXPECT_FALSE(isRigid(transform));
}

TEST(ProjectionGeometry, ProjectsWhereTheLineMeetsThePlane)
{
  const DetectorDescription description = obliqueDescription();
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(description);
  for (const Eigen::Vector3d& point : randomPoints(geometry))
  {
    // source + s (point - source) = origin + a x + b y, solved for s, a, b.
    Eigen::Matrix3d system;
    system << point - description.source, -description.x_direction, -description.y_direction;
    const Eigen::Vector3d solution = system.fullPivLu().solve(description.origin - description.source);
    const Eigen::Vector2d pixel = solution.tail<2>().cwiseQuotient(description.pixel_pitch);
    EXPECT_LT((geometry.project(point) - pixel).norm(), 1e-8);
    EXPECT_NEAR(geometry.magnification(point), solution[0], 1e-10 * solution[0]);
    EXPECT_NEAR(geometry.depth(point) * solution[0], geometry.sourceToDetector(), 1e-9);

    const Ray ray = geometry.backProject(pixel);
    EXPECT_EQ(ray.source, description.source);
    EXPECT_NEAR(ray.direction.norm(), 1.0, 1e-14);
    EXPECT_GT(ray.direction.dot(point - ray.source), 0.0);
    EXPECT_LT(ray.direction.cross(point - ray.source).norm(), 1e-9);
    EXPECT_LT((geometry.project(geometry.pixelPosition(pixel)) - pixel).norm(), 1e-9);
  }
}

TEST(ProjectionGeometry, JacobianAgreesWithFiniteDifferences)
{
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(obliqueDescription());
  constexpr double kStep = 1e-3;  // mm
  for (const Eigen::Vector3d& point : randomPoints(geometry))
  {
    const Eigen::Matrix<double, 2, 3> jacobian = geometry.projectionJacobian(point);
    for (int axis = 0; axis < 3; ++axis)
    {
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
      const Eigen::Vector2d difference =
          (geometry.project(point + step) - geometry.project(point - step)) / (2.0 * kStep);
      // Entries are about 10 px/mm; what the central difference leaves is (step / depth)^2 of that, 1e-10, and
      // rounding.
      EXPECT_LT((jacobian.col(axis) - difference).norm(), 1e-7);
    }
  }
}

TEST(ProjectionGeometry, FootIsWhereThePerpendicularMeetsThePanel)
{
  const DetectorDescription description = obliqueDescription();
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(description);
  const Eigen::Vector3d perpendicular = geometry.pixelPosition(geometry.foot()) - description.source;
  EXPECT_NEAR(perpendicular.dot(description.x_direction), 0.0, 1e-10);
  EXPECT_NEAR(perpendicular.dot(description.y_direction), 0.0, 1e-10);
  EXPECT_NEAR(perpendicular.norm(), geometry.sourceToDetector(), 1e-10);
  EXPECT_NEAR(geometry.sourceToDetector(), 1200.0, 1e-10);
  EXPECT_NEAR(geometry.focalLength().x(), 1200.0 / 0.4, 1e-9);
  EXPECT_NEAR(geometry.focalLength().y(), 1200.0 / 0.7, 1e-9);
}

TEST(ProjectionGeometry, BehindTheSourceIsNowhere)
{
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(obliqueDescription());
  const Eigen::Vector3d behind = geometry.roomFromOptical() * Eigen::Vector3d(1.0, 2.0, -3.0);
  EXPECT_LT(geometry.depth(behind), 0.0);
  EXPECT_TRUE(geometry.project(behind).array().isNaN().all());
  EXPECT_TRUE(geometry.projectionJacobian(behind).array().isNaN().all());
  EXPECT_TRUE(geometry.project(geometry.source()).array().isNaN().all());
}

TEST(ProjectionGeometry, IntrinsicsGiveTheSameCamera)
{
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(obliqueDescription());
  const auto camera = [&](double source_to_detector)
  {
    return ProjectionGeometry::fromIntrinsics("camera", geometry.imageSize(), geometry.focalLength(), geometry.foot(),
                                              geometry.roomFromOptical(), source_to_detector);
  };
  const ProjectionGeometry same = camera(geometry.sourceToDetector());
  EXPECT_LT((same.origin() - geometry.origin()).norm(), 1e-9);
  EXPECT_LT((same.pixelPitch() - geometry.pixelPitch()).norm(), 1e-12);
  const ProjectionGeometry nearer = camera(500.0);
  EXPECT_NEAR(nearer.sourceToDetector(), 500.0, 1e-9);
  for (const Eigen::Vector3d& point : randomPoints(geometry))
  {
    EXPECT_LT((same.project(point) - geometry.project(point)).norm(), 1e-8);
    EXPECT_LT((nearer.project(point) - geometry.project(point)).norm(), 1e-8);
    EXPECT_LT((nearer.backProject({ 7.0, 9.0 }).direction - geometry.backProject({ 7.0, 9.0 }).direction).norm(),
              1e-12);
  }

  expectError<std::invalid_argument>([&] { camera(kNan); }, { "camera", "source to detector", "nan" });
  expectError<std::invalid_argument>(
      [&]
      {
        ProjectionGeometry::fromIntrinsics("camera", { 4, 4 }, { 100.0, 0.0 }, { 2.0, 2.0 }, RigidTransform::Identity(),
                                           100.0);
      },
      { "camera", "focal length", "100   0", "positive" });
  expectError<std::invalid_argument>(
      [&]
      {
        RigidTransform mirrored = RigidTransform::Identity();
        mirrored.linear()(2, 2) = -1.0;
        ProjectionGeometry::fromIntrinsics("camera", { 4, 4 }, { 100.0, 100.0 }, { 2.0, 2.0 }, mirrored, 100.0);
      },
      { "camera", "rigid" });
}

TEST(ProjectionGeometry, RoundedDirectionsComeOutOrthonormal)
{
  DetectorDescription description = obliqueDescription();
  description.x_direction += 5e-5 * description.y_direction;
  description.y_direction *= 1.0 - 5e-5;
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(description);
  EXPECT_TRUE((geometry.roomFromOptical().linear().isUnitary(1e-14)));
  EXPECT_LT((geometry.xDirection() - description.x_direction).norm(), 1e-4);
}

TEST(ProjectionGeometry, RejectsBadDescriptions)
{
  const auto expectRejected = [](void (*spoil)(DetectorDescription&), const std::vector<std::string>& parts)
  {
    DetectorDescription description = obliqueDescription();
    spoil(description);
    expectError<std::invalid_argument>([&] { ProjectionGeometry::fromDescription(description); }, parts);
  };
  using D = DetectorDescription;
  expectRejected([](D& d) { d.name = ""; }, { "name", "letter" });
  expectRejected([](D& d) { d.name = "detector a/b"; }, { "name", "detector a/b" });
  expectRejected([](D& d) { d.image_size.y() = 0; }, { "oblique", "image_size", "300   0", "positive" });
  expectRejected([](D& d) { d.image_size.x() = 100000; }, { "oblique", "image_size", "100000", "16384" });
  expectRejected([](D& d) { d.pixel_pitch.x() = 1e-307; }, { "oblique", "focal length", "inf", "finite" });
  expectRejected([](D& d) { d.pixel_pitch.x() = -0.4; }, { "oblique", "pixel_pitch_mm", "-0.4", "positive" });
  expectRejected([](D& d) { d.pixel_pitch.x() = kNan; }, { "pixel_pitch_mm", "nan", "finite" });
  expectRejected([](D& d) { d.source.z() = kNan; }, { "source_mm", "nan", "finite" });
  expectRejected([](D& d) { d.origin.z() = std::numeric_limits<double>::infinity(); }, { "origin_mm", "inf" });
  expectRejected([](D& d) { d.x_direction *= 1.001; }, { "x_direction", "unit norm" });
  expectRejected([](D& d) { d.y_direction.setZero(); }, { "y_direction", "unit norm" });
  expectRejected([](D& d) { d.y_direction = d.x_direction; }, { "y_direction", "right angle", "1.0" });
  expectRejected([](D& d) { d.y_direction = (d.y_direction + 1e-3 * d.x_direction).normalized(); },
                 { "y_direction", "right angle" });
  expectRejected([](D& d) { d.y_direction *= -1.0; }, { "source_mm", "at least 1 mm", "-1200" });
  expectRejected([](D& d) { d.source = d.origin + 5.0 * d.x_direction; }, { "source_mm", "at least 1 mm" });
}

TEST(Triangulation, FindsThePoint)
{
  const std::vector<ProjectionGeometry> pair = loadPreset("cyberknife.yaml");
  std::vector<ProjectionGeometry> three = pair;
  DetectorDescription oblique = obliqueDescription();
  const Eigen::Vector3d to_room = Eigen::Vector3d(30.0, 20.0, 0.0) - 0.5 * (oblique.source + oblique.origin);
  oblique.source += to_room;
  oblique.origin += to_room;
  three.push_back(ProjectionGeometry::fromDescription(oblique));
  const Eigen::Vector3d point(12.0, -7.0, 23.0);
  for (const auto& views : { pair, three })
  {
    std::vector<Eigen::Vector2d> pixels;
    for (const ProjectionGeometry& view : views)
    {
      pixels.push_back(view.project(point));
    }
    EXPECT_LT((triangulate(views, pixels) - point).norm(), 1e-8);

    // With pixels that no point fits, no neighbour has a smaller reprojection error.
    pixels[0] += Eigen::Vector2d(3.0, -2.0);
    pixels[1] += Eigen::Vector2d(-4.0, 1.0);
    const auto cost = [&](const Eigen::Vector3d& candidate)
    {
      double sum = 0.0;
      for (std::size_t i = 0; i < views.size(); ++i)
      {
        sum += (views[i].project(candidate) - pixels[i]).squaredNorm();
      }
      return sum;
    };
    const Eigen::Vector3d best = triangulate(views, pixels);
    EXPECT_GT(cost(best), 1.0);
    for (int axis = 0; axis < 3; ++axis)
    {
      EXPECT_LT(cost(best), cost(best + 1e-3 * Eigen::Vector3d::Unit(axis)));
      EXPECT_LT(cost(best), cost(best - 1e-3 * Eigen::Vector3d::Unit(axis)));
    }
  }
}

TEST(Triangulation, RejectsWhatHasNoAnswer)
{
  const std::vector<ProjectionGeometry> pair = loadPreset("cyberknife.yaml");
  const auto expectRejected = [](const std::vector<ProjectionGeometry>& views,
                                 const std::vector<Eigen::Vector2d>& pixels, const std::vector<std::string>& parts)
  { expectError<std::invalid_argument>([&] { triangulate(views, pixels); }, parts); };
  const Eigen::Vector2d middle(255.5, 255.5);
  expectRejected({}, {}, { "0 views", "two or more" });
  expectRejected({ pair[0] }, { middle }, { "1 views", "two or more" });
  expectRejected(pair, { middle }, { "2 views and 1 pixels" });
  expectRejected({ pair[0], pair[0] }, { middle, middle }, { "parallel" });
  expectRejected(pair, { middle, { kNan, 0.0 } }, { "detector_b", "pixel", "nan" });

  // Side by side, looking the same way, each seeing the point on the far side: the rays part.
  DetectorDescription left = obliqueDescription();
  DetectorDescription right = left;
  right.source += 100.0 * right.x_direction;
  right.origin += 100.0 * right.x_direction;
  expectRejected({ ProjectionGeometry::fromDescription(left), ProjectionGeometry::fromDescription(right) },
                 { { 0.0, 50.0 }, { 299.0, 50.0 } }, { "in front", "oblique" });

  // Far off both panels.
  expectRejected(pair, { { -3836.8, 1582.2 }, { 4267.6, -4632.7 } }, { "no point", "detector_a", "too widely" });
}

/// What the refusal says makes the same view, upside down.
TEST(ProjectionGeometry, TellsWhatMendsALeftHandedPanel)
{
  const DetectorDescription right = obliqueDescription();
  DetectorDescription mirrored = right;
  mirrored.origin += (right.image_size.y() - 1) * right.pixel_pitch.y() * right.y_direction;
  mirrored.y_direction = -right.y_direction;
  std::string message;
  try
  {
    ProjectionGeometry::fromDescription(mirrored);
  }
  catch (const std::invalid_argument& error)
  {
    message = error.what();
  }
  Eigen::Vector3d origin, y;
  const std::size_t said = message.find("origin_mm: [");
  ASSERT_NE(std::string::npos, said) << message;
  ASSERT_EQ(6, std::sscanf(message.c_str() + said, "origin_mm: [%lf, %lf, %lf], y_direction: [%lf, %lf, %lf]",
                           &origin.x(), &origin.y(), &origin.z(), &y.x(), &y.y(), &y.z()));
  EXPECT_LT((origin - right.origin).norm(), 1e-5);
  EXPECT_LT((y - right.y_direction).norm(), 1e-8);
}

TEST(Presets, Cyberknife)
{
  const std::vector<ProjectionGeometry> views = loadPreset("cyberknife.yaml");
  ASSERT_EQ(views.size(), 2u);
  EXPECT_EQ(views[0].name(), "detector_a");
  EXPECT_EQ(views[1].name(), "detector_b");
  for (const ProjectionGeometry& view : views)
  {
    EXPECT_EQ(view.imageSize(), Eigen::Vector2i(512, 512));
    EXPECT_NEAR(view.sourceToDetector(), 3800.0, 1e-9);
    EXPECT_NEAR(view.source().norm(), 2600.0, 1e-9);
    // At 45 degrees to the vertical, above the patient, in the plane across room x.
    EXPECT_NEAR(view.source().z(), 2600.0 * std::sqrt(0.5), 1e-9);
    EXPECT_NEAR(view.source().x(), 0.0, 1e-12);
    EXPECT_LT((view.project(Eigen::Vector3d::Zero()) - Eigen::Vector2d(255.5, 255.5)).norm(), 1e-9);
    EXPECT_LT((view.foot() - Eigen::Vector2d(255.5, 255.5)).norm(), 1e-9);
    // Eq. (3): the isocentre is d = 1200 mm before the panel.
    EXPECT_NEAR(1.0 / view.magnification(Eigen::Vector3d::Zero()), (3800.0 - 1200.0) / 3800.0, 1e-12);
    // 10 mm along the couch, seen along the columns.
    EXPECT_NEAR(view.project({ 10.0, 0.0, 0.0 }).x(), 255.5 + 10.0 * 3800.0 / 2600.0 / 0.4, 1e-9);
  }
  EXPECT_NEAR(views[0].source().dot(views[1].source()), 0.0, 1e-6);
  // Rows run upwards in a, downwards in b.
  EXPECT_GT(views[0].project({ 0.0, 0.0, 10.0 }).y(), 255.5);
  EXPECT_LT(views[1].project({ 0.0, 0.0, 10.0 }).y(), 255.5);
}

TEST(Presets, OrthogonalLinac)
{
  const std::vector<ProjectionGeometry> views = loadPreset("orthogonal_linac.yaml");
  ASSERT_EQ(views.size(), 2u);
  const Eigen::Vector2d middle(511.5, 383.5);
  for (const ProjectionGeometry& view : views)
  {
    EXPECT_EQ(view.imageSize(), Eigen::Vector2i(1024, 768));
    EXPECT_NEAR(view.sourceToDetector(), 1500.0, 1e-9);
    EXPECT_NEAR(view.source().norm(), 1000.0, 1e-9);
    EXPECT_LT((view.project(Eigen::Vector3d::Zero()) - middle).norm(), 1e-9);
    // The patient's feet are at the lower edge of both images.
    EXPECT_GT(view.project({ -10.0, 0.0, 0.0 }).y(), middle.y());
  }
  EXPECT_EQ(views[0].source(), Eigen::Vector3d(0.0, 0.0, 1000.0));
  EXPECT_NEAR(views[0].source().dot(views[1].source()), 0.0, 1e-9);
  EXPECT_GT(views[0].project({ 0.0, -10.0, 0.0 }).x(), middle.x());  // the patient's left is at the right
  EXPECT_GT(views[1].project({ 0.0, 0.0, 10.0 }).x(), middle.x());   // anterior is at the right
}
}  // namespace
}  // namespace xray_tracking
