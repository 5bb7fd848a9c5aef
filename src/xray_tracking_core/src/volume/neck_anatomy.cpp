#include "neck_anatomy.h"

#include "part_builder.h"

namespace xray_tracking
{
namespace
{
using Shape = Solid::Shape;
using Eigen::Vector3d;

// Patient frame throughout, but for the jaw. Sizes are those of textbooks for an adult: neck 120 mm wide and 125 mm
// deep, head 148 mm wide, lower jaw 95-100 mm over its angles, pharynx 5 mm in front of C3, trachea 17 mm wide.

constexpr double kFatHu = -90.0;
constexpr double kAirHu = -1000.0;
constexpr double kSkullHu = 850.0;

const Vector3d kUp = Vector3d::UnitZ();

/// Head, neck and trunk meet in planes, so that nothing is counted twice: under the chin to the nape, and at the
/// shoulders.
const Vector3d kHeadNormal(0.0, -0.334, 0.943);
const Vector3d kHeadPoint(0.0, -62.0, 0.0);
const Vector3d kTrunkNormal(0.0, -0.124, 0.992);
const Vector3d kTrunkPoint(0.0, 60.0, -75.0);

/// Fat under the skin and muscle in it; the muscle is off-centre.
void addSoftTissue(PartBuilder& body)
{
  const double lean = 0.08;
  body.add(Shape::CYLINDER, { 0.0, 3.0, -20.0 }, { 60.0, 63.0, 115.0 }, kFatHu, kAirHu, lean)
      .cut(kHeadNormal, kHeadPoint)
      .cut(-kTrunkNormal, kTrunkPoint);
  body.add(Shape::CYLINDER, { 1.5, 1.5, -20.0 }, { 55.0, 57.0, 115.0 }, kMuscleHu, kFatHu, lean)
      .cut(kHeadNormal, kHeadPoint)
      .cut(-kTrunkNormal, kTrunkPoint);
  body.add(Shape::ELLIPSOID, { 0.0, -14.0, 75.0 }, { 74.0, 101.0, 105.0 }, kFatHu, kAirHu)
      .cut(-kHeadNormal, kHeadPoint);
  body.add(Shape::ELLIPSOID, { 0.5, -13.5, 75.0 }, { 70.0, 97.0, 102.0 }, kMuscleHu, kFatHu)
      .cut(-kHeadNormal, kHeadPoint);
  body.add(Shape::ELLIPSOID, { 0.0, 18.0, -140.0 }, { 190.0, 92.0, 84.0 }, kFatHu, kAirHu)
      .cut(kTrunkNormal, kTrunkPoint);
  body.add(Shape::ELLIPSOID, { 0.0, 18.0, -140.0 }, { 182.0, 85.0, 78.0 }, kMuscleHu, kFatHu)
      .cut(kTrunkNormal, kTrunkPoint);
  // Fat between the muscles at the sides, calcified right carotid, lobes of the thyroid gland (iodine).
  body.add(Shape::ELLIPSOID, { 38.0, 4.0, -24.0 }, { 6.0, 13.0, 24.0 }, kFatHu);
  body.add(Shape::ELLIPSOID, { -40.0, 8.0, -16.0 }, { 5.0, 10.0, 18.0 }, kFatHu);
  body.add(Shape::ELLIPSOID, { -26.0, -18.0, 3.0 }, { 1.4, 1.3, 4.5 }, 500.0);
  body.add(Shape::ELLIPSOID, { 16.0, -27.0, -45.0 }, { 6.0, 8.0, 19.0 }, 110.0);
  body.add(Shape::ELLIPSOID, { -15.5, -27.0, -47.0 }, { 5.5, 7.5, 16.0 }, 110.0);
}

/// From the nose's end to the trachea, in pieces that meet in oblique planes.
void addAirway(PartBuilder& body)
{
  struct Floor
  {
    Vector3d normal, point;
  };
  const Floor palate{ { 0.1, 0.5, 0.86 }, { 0.0, -24.0, 45.0 } };
  const Floor inlet{ { 0.15, -0.6, 0.79 }, { 0.0, -22.0, -11.0 } };
  const Floor folds{ { 0.1, 0.25, 0.96 }, { 0.0, -30.0, -21.0 } };
  const Floor glottis{ { -0.12, 0.3, 0.95 }, { 0.0, -30.0, -27.0 } };
  const Floor cricoid{ { 0.1, -0.4, 0.91 }, { 0.0, -31.0, -39.0 } };
  const auto piece =
      [&body](const Vector3d& middle, const Vector3d& half, double turn, const Floor& roof, const Floor& floor)
  {
    body.add(Shape::CYLINDER, middle, half, kAirHu, kMuscleHu, turn)
        .cut(roof.normal, roof.point)
        .cut(-floor.normal, floor.point);
  };
  body.add(Shape::ELLIPSOID, { 0.5, -27.0, 48.0 }, { 12.0, 8.0, 14.0 }, kAirHu).cut(-palate.normal, palate.point);
  piece({ 0.8, -18.0, 18.0 }, { 12.0, 4.5, 45.0 }, 0.1, palate, inlet);
  piece({ 0.5, -25.0, -15.0 }, { 7.5, 7.0, 20.0 }, 0.0, inlet, folds);
  piece({ 0.3, -32.0, -23.0 }, { 2.6, 9.5, 20.0 }, 0.0, folds, glottis);
  piece({ 0.0, -31.0, -32.0 }, { 7.0, 8.5, 20.0 }, 0.0, glottis, cricoid);
  body.rod(Shape::CYLINDER, { 0.0, -33.0, -28.0 }, { -3.0, -14.0, -112.0 }, 8.3, 8.0, kAirHu)
      .cut(cricoid.normal, cricoid.point);
  // Valleculae and piriform sinuses.
  body.add(Shape::ELLIPSOID, { 6.0, -30.0, 6.0 }, { 4.0, 2.6, 5.0 }, kAirHu);
  body.add(Shape::ELLIPSOID, { -5.5, -30.0, 5.0 }, { 3.6, 2.4, 4.0 }, kAirHu);
  body.add(Shape::ELLIPSOID, { 12.0, -20.0, -17.5 }, { 3.2, 3.6, 6.5 }, kAirHu);
  body.add(Shape::ELLIPSOID, { -11.5, -20.0, -17.0 }, { 2.8, 3.2, 5.0 }, kAirHu);
}

/// Hyoid bone, thyroid and cricoid cartilage, unevenly calcified.
void addLarynx(PartBuilder& body)
{
  body.rod(Shape::CYLINDER, { -11.0, -39.0, 3.5 }, { 11.0, -39.0, 4.5 }, 2.0, 4.5, 450.0);
  body.rod(Shape::CYLINDER, { 11.0, -38.5, 4.5 }, { 21.0, -17.0, 8.0 }, 1.3, 2.2, 400.0);
  body.rod(Shape::CYLINDER, { -11.0, -38.5, 3.5 }, { -21.5, -18.0, 6.0 }, 1.4, 2.2, 400.0);
  for (const double side : { -1.0, 1.0 })
  {
    body.rod(Shape::BOX, { side * 1.5, -46.0, -14.0 }, { side * 19.0, -22.0, -15.0 }, 1.2, 10.0,
             side > 0.0 ? 160.0 : 210.0);
    body.rod(Shape::CYLINDER, { side * 9.5, -21.0, -37.0 }, { side * 10.5, -33.0, -37.5 }, 1.4, 3.0, 240.0);
    body.rod(Shape::CYLINDER, { side * 10.5, -33.0, -37.5 }, { side * 1.0, -44.5, -38.0 }, 1.4, 3.0, 240.0);
  }
  body.add(Shape::BOX, { 0.0, -19.5, -35.0 }, { 8.5, 1.8, 7.5 }, 260.0);
}

/// Vault, hind fossa behind the foramen magnum, condyles, petrous bones, mastoids, clivus.
void addSkull(PartBuilder& body)
{
  const Vector3d vault(0.0, -2.0, 125.0), fossa(-1.0, 30.0, 78.0), seam(0.0, 0.0, 75.0);
  body.add(Shape::ELLIPSOID, vault, { 68.0, 88.0, 70.0 }, kSkullHu).cut(-kUp, seam);
  body.add(Shape::ELLIPSOID, vault, { 63.0, 82.5, 65.0 }, 35.0, kSkullHu).cut(-kUp, seam);
  const Vector3d forwards(0.0, -1.0, 0.0), opisthion(0.0, 17.0, 0.0);
  body.add(Shape::ELLIPSOID, fossa, { 55.0, 46.0, 19.0 }, kSkullHu).cut(kUp, seam).cut(forwards, opisthion);
  body.add(Shape::ELLIPSOID, fossa, { 50.5, 42.0, 14.5 }, 35.0, kSkullHu).cut(kUp, seam).cut(forwards, opisthion);
  body.add(Shape::ELLIPSOID, { 1.0, 68.0, 80.0 }, { 7.0, 10.0, 5.0 }, 600.0);
  for (const double side : { -1.0, 1.0 })
  {
    body.add(Shape::ELLIPSOID, { side * 17.0, 0.5, 67.0 }, { 5.5, 9.5, 4.6 }, 650.0);
    body.add(Shape::ELLIPSOID, { side * 53.0, 15.0, side > 0.0 ? 66.0 : 64.0 }, { 8.5, 10.0, 14.0 }, 420.0);
    body.rod(Shape::CYLINDER, { side * 44.0, 2.0, 80.0 }, { side * 14.0, -20.0, 80.0 }, 6.5, 6.0, 750.0);
  }
  body.rod(Shape::BOX, { 0.0, -10.0, 68.0 }, { 0.0, -28.0, 92.0 }, 12.0, 3.5, 550.0);
}

/// A row of teeth from the left to the right along an arch.
void addTeeth(PartBuilder& part, double z, double half_height)
{
  for (const double x : { -23.0, -20.0, -15.5, -9.5, -3.2, 3.2, 9.5, 15.5, 20.0, 23.0 })
  {
    // One is missing, lower and upper.
    if (x != 20.0)
    {
      part.add(Shape::CYLINDER, { x, -84.0 + 0.07 * x * x, z }, { 2.9, 3.3, half_height }, 1300.0);
    }
  }
}

/// Upper jaw: hard palate and teeth. Lower jaw: chin, body and ramus on either side, in axes of its own.
void addJaws(std::vector<Solid>& rest)
{
  PartBuilder upper(rest, RigidTransform::Identity());
  upper.add(Shape::BOX, { 0.0, -58.0, 60.0 }, { 17.0, 24.0, 1.6 }, 650.0);
  addTeeth(upper, 49.6, 7.2);

  // Turned in its joints: it hangs lower on the left.
  RigidTransform patient_from_jaw(Eigen::AngleAxisd(0.045, Vector3d::UnitY()));
  patient_from_jaw.pretranslate(Vector3d(1.5, 0.0, 1.0));
  PartBuilder jaw(rest, patient_from_jaw);
  const Vector3d alveoli(0.0, 0.0, 29.0);
  jaw.add(Shape::ELLIPSOID, { 0.0, -83.0, 14.0 }, { 17.0, 6.5, 12.5 }, 650.0);
  for (const double side : { -1.0, 1.0 })
  {
    const Vector3d chin(side * 11.0, -81.0, 15.0), angle(side * 46.0, -24.0, 30.0);
    jaw.rod(Shape::CYLINDER, chin, angle, 5.8, 13.0, 800.0).cut(kUp, alveoli);
    jaw.rod(Shape::CYLINDER, chin, angle, 3.9, 11.0, 350.0, 800.0).cut(kUp, alveoli);
    // The canal of the nerve.
    jaw.rod(Shape::CYLINDER, chin, angle, 1.3, 1.3, 120.0, 350.0).cut(kUp, alveoli);
    // The ramus, rounded off at the jaw's angle; it begins where the body ends.
    const Vector3d bottom(side * 47.5, -18.0, 14.0), top(side * 51.0, -11.0, 62.0);
    const Vector3d angle_normal(0.0, 0.64, -0.77), front_normal(-side * 0.52, -0.85, 0.0);
    jaw.rod(Shape::BOX, bottom, top, 3.4, 14.0, 750.0).cut(angle_normal, { 0.0, -14.0, 19.0 }).cut(front_normal, angle);
    jaw.rod(Shape::BOX, bottom, top, 1.6, 12.5, 350.0, 750.0)
        .cut(angle_normal, { 0.0, -15.0, 20.2 })
        .cut(front_normal, angle);
  }
  addTeeth(jaw, 34.6, 5.3);
}
}  // namespace

void addNeckSurroundings(std::vector<Solid>& rest)
{
  PartBuilder body(rest, RigidTransform::Identity());
  addSoftTissue(body);
  addAirway(body);
  addLarynx(body);
  addSkull(body);
  addJaws(rest);
}
}  // namespace xray_tracking
