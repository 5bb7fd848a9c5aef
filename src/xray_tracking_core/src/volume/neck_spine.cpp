#include <cmath>
#include <random>

#include "neck_anatomy.h"
#include "part_builder.h"

namespace xray_tracking
{
namespace
{
using Shape = Solid::Shape;
using Eigen::Vector3d;

// Each vertebra has axes of its own: origin in the middle of the body (C1: of the ring), x left, y posterior, z
// superior. Sizes are rounded from the ranges of Panjabi et al., Spine 16(8), 1991 (end plates 15-22 mm wide and 15-18
// mm deep, bodies 11-13 mm high, canal 15-18 mm deep and 23-25 mm wide, pedicles 5-6.5 mm wide and 7-7.5 mm high, 47-67
// mm over the transverse processes) and of Gilad and Nissan, J Anat 143, 1985 (depths, heights, discs of 5-6 mm).

constexpr double kCompactHu = 850.0;   // walls of the bodies
constexpr double kEndplateHu = 750.0;  // thinner than drawn, hence less dense
constexpr double kArchHu = 600.0;      // walls and little marrow, averaged
constexpr double kCancellousHu = 290.0;
constexpr double kDiscHu = 95.0;
constexpr double kWall = 1.1;  // [mm], thickness of a body's walls

struct Vertebra
{
  double z;                // of the origin, patient frame
  double yaw, roll;        // out of line with its neighbours, about z and y [rad]
  Vector3d body;           // half width, half depth, half height
  double mass_bottom;      // height of the lower facet below the origin, at the middle of the articular mass
  double spinous_length;   // behind the laminae
  double fork;             // half distance of the spinous process's two tips; 0: one tip
  double transverse_left;  // from the midline to the tip
  double transverse_right;
};

const Vertebra kAxis{ 38.0, 0.02, -0.015, { 7.9, 7.4, 8.0 }, 8.4, 11.0, 5.0, 25.0, 24.0 };
const Vertebra kC3{ 18.0, -0.02, 0.01, { 8.3, 7.5, 6.2 }, 7.9, 8.0, 3.2, 24.0, 23.0 };
const Vertebra kC4{ 0.0, 0.015, 0.02, { 8.6, 7.7, 6.2 }, 7.9, 9.0, 3.6, 26.5, 23.5 };
const Vertebra kC5{ -18.0, 0.03, -0.01, { 9.0, 7.9, 6.2 }, 7.9, 10.0, 3.0, 25.0, 24.5 };
const Vertebra kC6{ -36.0, -0.01, -0.02, { 9.8, 8.2, 6.2 }, 8.0, 15.0, 1.6, 25.5, 26.5 };
const Vertebra kC7{ -54.5, 0.0, -0.01, { 10.8, 8.3, 6.8 }, 8.4, 22.0, 0.0, 33.0, 34.0 };
const Vertebra kT1{ -74.0, 0.01, 0.0, { 12.5, 8.3, 7.6 }, 9.0, 20.0, 0.0, 37.0, 36.0 };
const Vertebra kT2{ -94.0, 0.0, 0.01, { 12.5, 8.7, 8.2 }, 9.0, 18.0, 0.0, 33.0, 33.0 };

/// Height of the upper facet above the origin; where the one above ends is 2 mm higher.
constexpr double kMassTop = 8.0;
constexpr double kMassX = 17.0;
/// The facets face up and backwards by 38 degrees.
const Vector3d kFacetNormal(0.0, 0.616, 0.788);

/// A vertebra's place on the spine's curve: lordosis of radius 260 mm (20 degrees from C2 to C7, as when supine), the
/// neck leaning forward by 0.08 rad.
RigidTransform placeOnCurve(double z, double yaw, double roll)
{
  constexpr double kRadius = 260.0, kLean = 0.08;
  RigidTransform patient_from_vertebra(Eigen::AngleAxisd(kLean - z / kRadius, Vector3d::UnitX()) *
                                       Eigen::AngleAxisd(roll, Vector3d::UnitY()) *
                                       Eigen::AngleAxisd(yaw, Vector3d::UnitZ()));
  patient_from_vertebra.pretranslate(Vector3d(0.0, z * z / (2.0 * kRadius) - kLean * z, z));
  return patient_from_vertebra;
}

RigidTransform placeOnCurve(const Vertebra& v)
{
  return placeOnCurve(v.z, v.yaw, v.roll);
}

/// Bone islands and marrow spaces of a body's cancellous core: denser and less dense ellipsoids of 2 to 5 mm.
void addTrabeculae(PartBuilder& part, const Vector3d& core, std::uint32_t seed)
{
  std::mt19937 generator(seed);
  // Not std::uniform_real_distribution, whose numbers differ among libraries.
  const auto between = [&generator](double low, double high)
  { return low + (high - low) * generator() / 4294967295.0; };
  for (int i = 0; i < 8; ++i)
  {
    const Vector3d half(between(1.0, 2.4), between(1.0, 2.4), between(1.0, 2.4));
    const double angle = 0.25 * M_PI * (i + between(0.0, 1.0)), share = std::sqrt(between(0.0, 1.0));
    const Vector3d room = core - half;
    const Vector3d centre(share * std::cos(angle) * room.x(), share * std::sin(angle) * room.y() - 0.8,
                          between(-room.z(), room.z()));
    part.add(Shape::ELLIPSOID, centre, half, kCancellousHu + (i % 2 ? -85.0 : 190.0), kCancellousHu);
  }
}

void addBody(PartBuilder& part, const Vertebra& v)
{
  const Vector3d& body = v.body;
  const double back = body.y() - 1.5;  // the flat hind wall
  const double plate = 0.6;            // half the thickness of an end plate with its rim
  const Vector3d backwards = Vector3d::UnitY();
  for (const double side : { -1.0, 1.0 })
  {
    part.add(Shape::CYLINDER, { 0.0, side < 0.0 ? -0.5 : 0.0, side * (body.z() - plate) },
             { body.x(), body.y(), plate }, kEndplateHu)
        .cut(backwards, { 0.0, back, 0.0 });
  }
  // The waist between the rims.
  const Vector3d waist(body.x() - 0.7, body.y() - 0.7, body.z() - 2.0 * plate);
  const Vector3d core = waist - Vector3d(kWall, kWall, 0.0);
  part.add(Shape::CYLINDER, Vector3d::Zero(), waist, kCompactHu).cut(backwards, { 0.0, back, 0.0 });
  part.add(Shape::CYLINDER, Vector3d::Zero(), core, kCancellousHu, kCompactHu)
      .cut(backwards, { 0.0, back - kWall, 0.0 });
  // The basivertebral vein.
  part.add(Shape::ELLIPSOID, { 0.6, back - kWall - 2.6, 0.3 }, { 1.8, 2.4, 1.2 }, 190.0, kCancellousHu);
  addTrabeculae(part, core - Vector3d(0.0, 1.6, 0.3), static_cast<std::uint32_t>(1000.0 + v.z));
}

void addUncinateProcesses(PartBuilder& part, const Vertebra& v)
{
  for (const double side : { -1.0, 1.0 })
  {
    // The left ones are worn.
    const double height = side < 0.0 ? 3.4 : 2.4;
    part.add(Shape::ELLIPSOID, { side * (v.body.x() - 1.3), 0.6, v.body.z() }, { 1.7, v.body.y() - 3.2, height }, 800.0)
        .cut(-Vector3d::UnitZ(), { 0.0, 0.0, v.body.z() });
  }
}

/// A column of bone between two facet planes, given by their heights in its middle.
void addArticularMass(PartBuilder& part, const Vector3d& middle, const Vector3d& half, double top, double bottom)
{
  const double wall = 1.2;
  const Vector3d top_point(middle.x(), middle.y(), top), bottom_point(middle.x(), middle.y(), -bottom);
  part.add(Shape::CYLINDER, middle, half, 700.0).cut(kFacetNormal, top_point).cut(-kFacetNormal, bottom_point);
  part.add(Shape::CYLINDER, middle, half - Vector3d(wall, wall, 0.0), kCancellousHu, 700.0)
      .cut(kFacetNormal, top_point - wall * kFacetNormal)
      .cut(-kFacetNormal, bottom_point + wall * kFacetNormal);
}

/// Laminae and spinous process, behind the given point of the midline.
void addHindArch(PartBuilder& part, const Vertebra& v, const Vector3d& junction, double half_height)
{
  for (const double side : { -1.0, 1.0 })
  {
    part.rod(Shape::BOX, { side * 15.0, junction.y() - 8.2, junction.z() + 2.5 },
             { -side, junction.y() + 0.6, junction.z() }, 1.8, half_height, kArchHu)
        .cut({ -side, 0.0, 0.0 }, Vector3d::Zero());
  }
  const Vector3d backwards(0.02, 0.93, -0.36);
  const Vector3d root = junction - Vector3d(0.0, 0.5, 0.0);
  const Vector3d tip = junction + v.spinous_length * backwards;
  part.rod(Shape::CYLINDER, root, tip, 2.6, half_height - 1.0, kArchHu);
  part.rod(Shape::CYLINDER, root + 2.5 * backwards, tip - 1.0 * backwards, 1.4, half_height - 2.4, kCancellousHu,
           kArchHu);
  if (v.fork > 0.0)
  {
    part.rod(Shape::CYLINDER, tip, tip + Vector3d(v.fork, 4.6, -2.4), 1.8, 2.2, 500.0);
    part.rod(Shape::CYLINDER, tip, tip + Vector3d(-v.fork, 3.4, -2.0), 1.7, 2.0, 500.0);
  }
  else
  {
    part.add(Shape::ELLIPSOID, tip, { 3.6, 2.6, half_height - 0.4 }, kArchHu);
  }
}

void addPedicle(PartBuilder& part, const Vertebra& v, double side)
{
  part.rod(Shape::CYLINDER, { side * (v.body.x() - 2.0), v.body.y() - 2.6, 1.6 },
           { side * 13.2, v.body.y() + 1.8, 1.2 }, 2.7, 3.5, 500.0);
}

/// Two bars and the plate between their tubercles, around the foramen of the vertebral artery.
void addTransverseProcess(PartBuilder& part, const Vertebra& v, double side)
{
  const double tip_x = side > 0.0 ? v.transverse_left : v.transverse_right;
  const double front_x = v.body.x() + 9.0;
  const Vector3d front(side * front_x, -0.6, -2.6);
  const Vector3d hind(side * (tip_x - 2.5), v.body.y() - 1.0, -4.0);
  part.rod(Shape::CYLINDER, { side * (v.body.x() - 0.8), 1.6, -1.0 }, front, 1.5, 2.2, 480.0);
  part.rod(Shape::CYLINDER, { side * 14.5, v.body.y() + 2.0, -2.0 }, hind, 2.0, 2.6, 480.0);
  part.rod(Shape::CYLINDER, front, hind, 1.1, 2.4, 450.0);
  // C6's front tubercle is the large one.
  const double tubercle = v.z == kC6.z ? 3.4 : 2.4;
  part.add(Shape::ELLIPSOID, front, { tubercle, 0.9 * tubercle, 1.2 * tubercle }, 520.0);
  part.add(Shape::ELLIPSOID, hind, { 2.5, 2.3, 3.2 }, 520.0);
}

/// C3 and below.
void addLowerVertebra(std::vector<Solid>& solids, const Vertebra& v)
{
  PartBuilder part(solids, placeOnCurve(v));
  addBody(part, v);
  addUncinateProcesses(part, v);
  for (const double side : { -1.0, 1.0 })
  {
    addPedicle(part, v, side);
    addArticularMass(part, { side * kMassX, v.body.y() + 4.3, 0.0 }, { side > 0.0 ? 5.7 : 5.3, 5.0, 12.5 }, kMassTop,
                     v.mass_bottom);
    addTransverseProcess(part, v, side);
  }
  addHindArch(part, v, { 0.0, v.body.y() + 16.2, -3.5 }, 5.0);
}

void addAxis(std::vector<Solid>& solids)
{
  const Vertebra& v = kAxis;
  PartBuilder part(solids, placeOnCurve(v));
  addBody(part, v);
  // The dens, leaning backwards by 0.1 rad, and its tip.
  const Vector3d base(0.4, -0.4, v.body.z()), up(0.0, 0.1, 0.995), neck = base + 11.0 * up;
  part.rod(Shape::CYLINDER, base, neck, 5.3, 5.0, 900.0).rod(Shape::CYLINDER, base, neck, 4.0, 3.7, 400.0, 900.0);
  part.add(Shape::ELLIPSOID, neck, { 5.3, 5.0, 5.6 }, 850.0).cut(-up, neck);
  for (const double side : { -1.0, 1.0 })
  {
    // Sloping shoulders that carry C1.
    const Vector3d shoulder(side * 13.2, 1.6, 5.6);
    part.add(Shape::ELLIPSOID, shoulder, { 6.8, 8.2, 4.6 }, 650.0).cut({ -side, 0.0, 0.0 }, { side * 7.6, 0.0, 0.0 });
    part.add(Shape::ELLIPSOID, shoulder, { 5.4, 6.8, 3.4 }, 330.0, 650.0)
        .cut({ -side, 0.0, 0.0 }, { side * 8.6, 0.0, 0.0 });
    part.rod(Shape::CYLINDER, { side * 14.5, 6.5, 2.6 }, { side * 16.6, 13.0, -2.5 }, 3.8, 3.0, 520.0);
    addArticularMass(part, { side * kMassX, v.body.y() + 4.6, -6.0 }, { 5.4, 5.0, 12.0 }, -1.0, v.mass_bottom);
    const Vector3d tip(side * (side > 0.0 ? v.transverse_left : v.transverse_right), 5.5, -3.0);
    part.rod(Shape::CYLINDER, { side * 17.0, 3.5, 2.0 }, tip, 1.8, 2.4, 480.0);
    part.rod(Shape::CYLINDER, { side * 7.5, 2.5, -2.0 }, tip, 1.6, 2.0, 480.0);
    part.add(Shape::ELLIPSOID, tip, { 2.6, 2.6, 3.0 }, 520.0);
  }
  addHindArch(part, v, { 0.0, v.body.y() + 17.0, -6.0 }, 6.2);
}

/// A ring without a body; 75-80 mm over the transverse processes, 30 mm from arch to arch.
void addAtlas(std::vector<Solid>& solids)
{
  PartBuilder part(solids, placeOnCurve(54.5, -0.03, 0.02));
  part.add(Shape::ELLIPSOID, { 0.8, -12.2, -1.0 }, { 3.0, 2.2, 4.2 }, 700.0);
  part.add(Shape::ELLIPSOID, { -1.0, 27.5, 0.5 }, { 3.2, 2.4, 3.8 }, 650.0);
  for (const double side : { -1.0, 1.0 })
  {
    const Vector3d midline_normal(-side, 0.0, 0.0);
    part.rod(Shape::CYLINDER, { side * 13.0, -6.0, 0.0 }, { -side * 0.5, -11.2, 0.0 }, 2.4, 4.8, 650.0)
        .cut(midline_normal, Vector3d::Zero());
    part.add(Shape::CYLINDER, { side * 18.0, -0.5, 0.3 }, { 6.3, 8.6, 5.6 }, 700.0);
    part.add(Shape::CYLINDER, { side * 18.0, -0.5, 0.3 }, { 5.0, 7.3, 4.5 }, 330.0, 700.0);
    part.rod(Shape::CYLINDER, { side * 19.5, 6.8, 0.5 }, { side * 15.5, 17.5, 1.2 }, 2.2, 2.8, 600.0);
    part.rod(Shape::CYLINDER, { side * 15.5, 17.5, 1.2 }, { side * 8.0, 24.2, 1.0 }, 2.2, 3.4, 600.0);
    part.rod(Shape::CYLINDER, { side * 8.0, 24.2, 1.0 }, { -side * 0.5, 26.4, 0.8 }, 2.2, 3.6, 600.0)
        .cut(midline_normal, Vector3d::Zero());
    const Vector3d tip(side * (side > 0.0 ? 37.5 : 34.5), 4.0, -2.0);
    part.rod(Shape::CYLINDER, { side * 23.5, -2.5, 0.0 }, tip, 1.8, 2.6, 480.0);
    part.rod(Shape::CYLINDER, { side * 22.5, 6.0, 0.0 }, tip, 1.9, 2.6, 480.0);
    part.add(Shape::ELLIPSOID, tip, { 3.8, 3.4, 4.4 }, 520.0);
  }
}

/// Between the facing end plates of two vertebrae.
void addDisc(std::vector<Solid>& solids, const Vertebra& upper, const Vertebra& lower)
{
  const Vector3d top = placeOnCurve(upper) * Vector3d(0.0, 0.0, -upper.body.z());
  const Vector3d bottom = placeOnCurve(lower) * Vector3d(0.0, 0.0, lower.body.z());
  PartBuilder part(solids, placeOnCurve(0.5 * (upper.z + lower.z), 0.0, 0.0));
  const Vector3d middle = placeOnCurve(0.5 * (upper.z + lower.z), 0.0, 0.0).inverse() * (0.5 * (top + bottom));
  part.add(Shape::CYLINDER, middle, { upper.body.x() - 1.2, upper.body.y() - 0.6, 0.5 * (top - bottom).norm() },
           kDiscHu)
      .cut(Vector3d::UnitY(), { 0.0, upper.body.y() - 1.2, 0.0 });
}

void addRibs(std::vector<Solid>& solids, const Vertebra& v)
{
  PartBuilder part(solids, placeOnCurve(v));
  for (const double side : { -1.0, 1.0 })
  {
    const Vector3d angle(side * 43.0, 12.0, -1.0), front(side * 56.0, -8.0, -9.0);
    part.rod(Shape::CYLINDER, { side * 15.0, 6.5, 4.5 }, angle, 2.6, 4.0, 450.0);
    part.rod(Shape::CYLINDER, angle, front, 2.6, 5.0, 450.0);
  }
}
}  // namespace

void addCervicalSpine(NeckSolids& neck)
{
  for (const Vertebra* v : { &kC3, &kC4, &kC5 })
  {
    addLowerVertebra(neck.target, *v);
  }
  addDisc(neck.target, kC3, kC4);
  addDisc(neck.target, kC4, kC5);
  // Wear: a spur at the right front edge of C5's lower end plate, one at C4's left hind edge, a dense island in C3.
  PartBuilder(neck.target, placeOnCurve(kC5)).add(Shape::ELLIPSOID, { -4.5, -8.4, -5.4 }, { 3.4, 2.4, 1.9 }, 700.0);
  PartBuilder(neck.target, placeOnCurve(kC4)).add(Shape::ELLIPSOID, { 6.5, 6.4, -5.6 }, { 2.6, 1.8, 1.5 }, 650.0);
  PartBuilder(neck.target, placeOnCurve(kC3))
      .add(Shape::ELLIPSOID, { 3.2, -2.0, 1.0 }, { 1.6, 2.0, 1.8 }, 800.0, kCancellousHu);

  addAtlas(neck.rest);
  addAxis(neck.rest);
  for (const Vertebra* v : { &kC6, &kC7, &kT1, &kT2 })
  {
    addLowerVertebra(neck.rest, *v);
  }
  addDisc(neck.rest, kAxis, kC3);
  addDisc(neck.rest, kC5, kC6);
  addDisc(neck.rest, kC6, kC7);
  addDisc(neck.rest, kC7, kT1);
  addDisc(neck.rest, kT1, kT2);
  addRibs(neck.rest, kT1);
  addRibs(neck.rest, kT2);
}

Eigen::AlignedBox3d boxAroundC4()
{
  return { Vector3d(-24.0, -8.5, -11.0), Vector3d(26.5, 39.0, 13.0) };
}
}  // namespace xray_tracking
