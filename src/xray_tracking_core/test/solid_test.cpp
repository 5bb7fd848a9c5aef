#include "xray_tracking_core/volume/solid.h"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "test_helpers.h"

namespace xray_tracking
{
namespace
{
using Eigen::Vector3d;
using Shape = Solid::Shape;

constexpr Materials kBone{ -0.5, 1.0 };
const RigidTransform kIdentity = RigidTransform::Identity();

Solid solidAt(Shape shape, const Vector3d& centre, const Vector3d& half_axes)
{
  return Solid(shape, RigidTransform(Eigen::Translation3d(centre)), half_axes, kBone);
}

/// A solid with the inequalities that define it, written down once more.
struct RandomSolid
{
  Shape shape;
  RigidTransform patient_from_solid;
  Vector3d half_axes;
  std::vector<std::pair<Vector3d, double>> cuts;

  explicit RandomSolid(std::mt19937& generator)
  {
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    std::uniform_real_distribution<double> size(2.0, 15.0);
    shape = static_cast<Shape>(generator() % 3);
    patient_from_solid =
        Eigen::Translation3d(20.0 * unit(generator), 20.0 * unit(generator), 20.0 * unit(generator)) *
        Eigen::Quaterniond(unit(generator), unit(generator), unit(generator), unit(generator)).normalized();
    half_axes = { size(generator), size(generator), size(generator) };
    for (unsigned i = generator() % 3; i > 0; --i)
    {
      const Vector3d normal(unit(generator), unit(generator), unit(generator));
      cuts.emplace_back(normal, normal.dot(patient_from_solid.translation()) + 3.0 * unit(generator));
    }
  }

  Solid make() const
  {
    Solid solid(shape, patient_from_solid, half_axes, kBone);
    for (const auto& cut : cuts)
    {
      solid.cutBy(cut.first, cut.second);
    }
    return solid;
  }

  bool holds(const Vector3d& point) const
  {
    const Vector3d p = patient_from_solid.inverse() * point;
    const double x = p.x() / half_axes.x(), y = p.y() / half_axes.y(), z = p.z() / half_axes.z();
    bool inside = true;
    for (const auto& cut : cuts)
    {
      inside = inside && cut.first.dot(point) <= cut.second;
    }
    switch (shape)
    {
      case Shape::ELLIPSOID:
        return inside && x * x + y * y + z * z <= 1.0;
      case Shape::CYLINDER:
        return inside && x * x + y * y <= 1.0 && std::abs(z) <= 1.0;
      default:
        return inside && std::abs(x) <= 1.0 && std::abs(y) <= 1.0 && std::abs(z) <= 1.0;
    }
  }
};

TEST(Solid, SphereChords)
{
  const Solid sphere = solidAt(Shape::ELLIPSOID, { 1.0, 2.0, 3.0 }, Vector3d::Constant(7.0));
  for (const double miss : { 0.0, 1.0, 5.0, 6.99 })
  {
    // From as far away as a focal spot.
    const RaySegment segment = sphere.intersect({ { 1.0 - 2600.0, 2.0 + miss, 3.0 }, Vector3d::UnitX() });
    const double half_chord = std::sqrt(49.0 - miss * miss);
    EXPECT_NEAR(segment.enter, 2600.0 - half_chord, 1e-6);
    EXPECT_NEAR(segment.exit, 2600.0 + half_chord, 1e-6);
  }
  EXPECT_EQ(sphere.intersect({ { -2600.0, 9.01, 3.0 }, Vector3d::UnitX() }).length(), 0.0);
}

TEST(Solid, CylinderChords)
{
  const Solid cylinder = solidAt(Shape::CYLINDER, Vector3d::Zero(), { 4.0, 6.0, 10.0 });
  EXPECT_NEAR(cylinder.intersect({ { -100.0, 0.0, 9.9 }, Vector3d::UnitX() }).length(), 8.0, 1e-9);
  EXPECT_NEAR(cylinder.intersect({ { 0.0, -100.0, 0.0 }, Vector3d::UnitY() }).length(), 12.0, 1e-9);
  EXPECT_EQ(cylinder.intersect({ { -100.0, 0.0, 10.1 }, Vector3d::UnitX() }).length(), 0.0);
  // Along the axis, inside and outside the mantle.
  EXPECT_NEAR(cylinder.intersect({ { 3.0, 0.0, -50.0 }, Vector3d::UnitZ() }).length(), 20.0, 1e-9);
  EXPECT_EQ(cylinder.intersect({ { 4.1, 0.0, -50.0 }, Vector3d::UnitZ() }).length(), 0.0);
  // Through mantle and cap: from x = -4, z = 6 to the cap at z = 10, x = 0.
  EXPECT_NEAR(cylinder.intersect({ { -14.0, 0.0, -4.0 }, Vector3d(1.0, 0.0, 1.0).normalized() }).length(),
              4.0 * std::sqrt(2.0), 1e-9);
}

TEST(Solid, BoxChords)
{
  const Solid box = solidAt(Shape::BOX, { 10.0, 0.0, 0.0 }, { 1.0, 2.0, 3.0 });
  const Vector3d diagonal = Vector3d(1.0, 2.0, 3.0);
  EXPECT_NEAR(box.intersect({ Vector3d(10.0, 0.0, 0.0) - 50.0 * diagonal, diagonal.normalized() }).length(),
              2.0 * diagonal.norm(), 1e-9);
  EXPECT_NEAR(box.intersect({ { 0.0, 1.9, 2.9 }, Vector3d::UnitX() }).length(), 2.0, 1e-9);
  EXPECT_EQ(box.intersect({ { 0.0, 2.1, 0.0 }, Vector3d::UnitX() }).length(), 0.0);
}

TEST(Solid, CutsTakeAway)
{
  Solid half = solidAt(Shape::ELLIPSOID, Vector3d::Zero(), Vector3d::Constant(5.0));
  half.cutBy({ 2.0, 0.0, 0.0 }, 2.0);  // x <= 1
  const RaySegment through = half.intersect({ { -100.0, 0.0, 0.0 }, Vector3d::UnitX() });
  EXPECT_NEAR(through.enter, 95.0, 1e-9);
  EXPECT_NEAR(through.exit, 101.0, 1e-9);
  // Along the plane, on either side.
  EXPECT_NEAR(half.intersect({ { 0.9, -100.0, 0.0 }, Vector3d::UnitY() }).length(), 2.0 * std::sqrt(25.0 - 0.81), 1e-9);
  EXPECT_EQ(half.intersect({ { 1.1, -100.0, 0.0 }, Vector3d::UnitY() }).length(), 0.0);
  half.cutBy({ -1.0, 0.0, 0.0 }, -2.0);  // x >= 2: nothing is left
  EXPECT_EQ(half.intersect({ { -100.0, 0.0, 0.0 }, Vector3d::UnitX() }).length(), 0.0);
}

TEST(Solid, RaysBeginAtTheirSource)
{
  for (const Shape shape : { Shape::ELLIPSOID, Shape::CYLINDER, Shape::BOX })
  {
    const Solid solid = solidAt(shape, Vector3d::Zero(), Vector3d::Constant(5.0));
    const RaySegment from_inside = solid.intersect({ { 2.0, 0.0, 0.0 }, Vector3d::UnitX() });
    EXPECT_EQ(from_inside.enter, 0.0);
    EXPECT_NEAR(from_inside.exit, 3.0, 1e-12);
    EXPECT_EQ(solid.intersect({ { 6.0, 0.0, 0.0 }, Vector3d::UnitX() }).length(), 0.0);
  }
}

TEST(Solid, RandomSolidsAgreeWithMarching)
{
  std::mt19937 generator(5);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  constexpr double kStep = 0.02;
  int hits = 0, longer_directions = 0;
  for (int i = 0; i < 300; ++i)
  {
    const RandomSolid truth(generator);
    const Solid solid = truth.make();
    const Vector3d aim =
        truth.patient_from_solid *
        (0.8 * truth.half_axes.cwiseProduct(Vector3d(unit(generator), unit(generator), unit(generator))));
    const Vector3d source = 100.0 * Vector3d(unit(generator), unit(generator), unit(generator)).normalized();
    const Ray ray{ source, (aim - source).normalized() };
    int steps_inside = 0;
    for (double t = 0.5 * kStep; t < 200.0; t += kStep)
    {
      const Vector3d point = ray.source + t * ray.direction;
      const bool inside = truth.holds(point);
      steps_inside += inside;
      ASSERT_EQ(solid.contains(point), inside) << "solid " << i << " at " << point.transpose();
    }
    const RaySegment segment = solid.intersect(ray);
    // Marching misjudges each end by up to half a step.
    EXPECT_NEAR(segment.length(), steps_inside * kStep, 1.01 * kStep) << "solid " << i;
    hits += steps_inside > 0;
    if (segment.length() > 0.0)
    {
      // The ends lie on the surface.
      for (const double inwards : { 1e-6, -1e-6 })
      {
        EXPECT_EQ(truth.holds(ray.source + (segment.exit - inwards) * ray.direction), inwards > 0.0);
        EXPECT_EQ(truth.holds(ray.source + (segment.enter + inwards) * ray.direction),
                  inwards > 0.0 && segment.length() > 1e-6);
      }
      const RaySegment scaled = SolidFromSource(solid, source).intersect(10.0 * ray.direction);
      EXPECT_NEAR(10.0 * scaled.enter, segment.enter, 1e-9);
      EXPECT_NEAR(10.0 * scaled.exit, segment.exit, 1e-9);
      ++longer_directions;
    }
  }
  EXPECT_GT(hits, 100);
  EXPECT_GT(longer_directions, 100);
}

TEST(Solid, BoundsAreTight)
{
  std::mt19937 generator(9);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 60; ++i)
  {
    RandomSolid truth(generator);
    truth.cuts.clear();
    const Solid solid = truth.make();
    // Points of the surface, dense at the corners of boxes and the rims of cylinders.
    Eigen::AlignedBox3d seen, in_own_axes;
    double radius = 0.0;
    for (int j = 0; j < 20000; ++j)
    {
      Vector3d p(normal(generator), normal(generator), normal(generator));
      if (truth.shape == Shape::ELLIPSOID)
      {
        p.normalize();
      }
      else if (truth.shape == Shape::CYLINDER)
      {
        p.head<2>().normalize();
        p.z() = p.z() > 0.0 ? 1.0 : -1.0;
      }
      else
      {
        p = p.cwiseSign();
      }
      const Vector3d surface = truth.half_axes.cwiseProduct(p);
      in_own_axes.extend(surface);
      radius = std::max(radius, surface.norm());
      seen.extend(truth.patient_from_solid * surface);
    }
    // 20000 directions come within 3 degrees of any: 1 - cos(3 degrees) of at most 15 mm.
    constexpr double kTolerance = 0.03;
    EXPECT_LT((solid.boundingBox().min() - seen.min()).cwiseAbs().maxCoeff(), kTolerance);
    EXPECT_LT((solid.boundingBox().max() - seen.max()).cwiseAbs().maxCoeff(), kTolerance);
    EXPECT_NEAR(solid.boundingRadius(), radius, kTolerance);
    EXPECT_GE(solid.boundingRadius(), radius - 1e-9);
    Eigen::AlignedBox3d corners;
    for (const Vector3d& corner : solid.corners())
    {
      corners.extend(truth.patient_from_solid.inverse() * corner);
    }
    EXPECT_LT((corners.min() - in_own_axes.min()).cwiseAbs().maxCoeff(), kTolerance);
    EXPECT_LT((corners.max() - in_own_axes.max()).cwiseAbs().maxCoeff(), kTolerance);
    EXPECT_TRUE(solid.centre().isApprox(truth.patient_from_solid.translation()));
  }
}

TEST(Solid, RefusesBadSizes)
{
  for (const double bad :
       { 0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity() })
  {
    expectError<std::invalid_argument>(
        [bad] {
          Solid(Shape::BOX, kIdentity, { 1.0, bad, 1.0 }, kBone);
        },
        { "half_axes", "positive" });
  }
}
}  // namespace
}  // namespace xray_tracking
