#include "xray_tracking_core/plan/treatment_plan.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>

#include "rt_file.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kInstance(0x0008, 0x1155);
const gdcm::Tag kPatientId(0x0010, 0x0020);
const gdcm::Tag kPatientPosition(0x0018, 0x5100);
const gdcm::Tag kFrameOfReference(0x0020, 0x0052);
const gdcm::Tag kBeams(0x300a, 0x00b0);
const gdcm::Tag kBeamNumber(0x300a, 0x00c0);
const gdcm::Tag kBeamName(0x300a, 0x00c2);
const gdcm::Tag kDeliveryType(0x300a, 0x00ce);
const gdcm::Tag kControlPoints(0x300a, 0x0111);
const gdcm::Tag kIsocentre(0x300a, 0x012c);
const gdcm::Tag kSetups(0x300a, 0x0180);
const gdcm::Tag kSetupNumber(0x300a, 0x0182);
const gdcm::Tag kStructureSets(0x300c, 0x0060);
const gdcm::Tag kReferencedSetup(0x300c, 0x006a);

constexpr double kDegree = M_PI / 180.0;
/// No patient is larger [mm].
constexpr double kFarthest = 1e4;
/// Planning systems write angles and places with a few decimals.
constexpr double kSameAngle = 0.01;  // [degrees]
constexpr double kSamePlace = 0.01;  // [mm]

struct Angle
{
  const char* name;
  gdcm::Tag tag;
  double PlanBeam::*value;
  bool turns_patient;
};

const std::vector<Angle> kAngles{
  { "GantryAngle (300A,011E)", { 0x300a, 0x011e }, &PlanBeam::gantry_angle, false },
  { "PatientSupportAngle (300A,0122)", { 0x300a, 0x0122 }, &PlanBeam::couch_angle, true },
  { "TableTopEccentricAngle (300A,0125)", { 0x300a, 0x0125 }, &PlanBeam::eccentric_angle, true },
  { "TableTopPitchAngle (300A,0140)", { 0x300a, 0x0140 }, &PlanBeam::pitch_angle, true },
  { "TableTopRollAngle (300A,0144)", { 0x300a, 0x0144 }, &PlanBeam::roll_angle, true },
};

constexpr std::size_t kCouch = 1;

/// Rows: the table top's X, Y, Z (of a couch at 0: to the right of who faces the gantry, to the gantry, up) in LPS.
/// Decubitus right: the right side is down.
const std::map<std::string, Eigen::Matrix3d>& tableTopsFromPatient()
{
  static const auto rows = [](double a, double b, double c, double d, double e, double f, double g, double h, double i)
  { return (Eigen::Matrix3d() << a, b, c, d, e, f, g, h, i).finished(); };
  static const std::map<std::string, Eigen::Matrix3d> kTableTops{
    { "HFS", rows(1, 0, 0, 0, 0, 1, 0, -1, 0) },    // left, superior, anterior
    { "HFP", rows(-1, 0, 0, 0, 0, 1, 0, 1, 0) },    // right, superior, posterior
    { "HFDR", rows(0, 1, 0, 0, 0, 1, 1, 0, 0) },    // posterior, superior, left
    { "HFDL", rows(0, -1, 0, 0, 0, 1, -1, 0, 0) },  // anterior, superior, right
    { "FFS", rows(-1, 0, 0, 0, 0, -1, 0, -1, 0) },  // right, inferior, anterior
    { "FFP", rows(1, 0, 0, 0, 0, -1, 0, 1, 0) },    // left, inferior, posterior
    { "FFDR", rows(0, -1, 0, 0, 0, -1, 1, 0, 0) },  // anterior, inferior, left
    { "FFDL", rows(0, 1, 0, 0, 0, -1, -1, 0, 0) },  // posterior, inferior, right
  };
  return kTableTops;
}

std::string placeText(const Eigen::Vector3d& place)
{
  std::ostringstream text;
  text << place.x() << " " << place.y() << " " << place.z();
  return text.str();
}

/// Least difference of two angles, whatever turns lie between them [degrees].
double between(double a, double b)
{
  return std::abs(std::remainder(a - b, 360.0));
}

bool liesAlike(const PlanBeam& a, const PlanBeam& b)
{
  return a.patient_position == b.patient_position && (a.isocentre - b.isocentre).norm() <= kSamePlace &&
         std::all_of(kAngles.begin(), kAngles.end(),
                     [&](const Angle& angle)
                     { return !angle.turns_patient || between(a.*angle.value, b.*angle.value) <= kSameAngle; });
}

/// Takes over what a control point says; later ones leave out what does not change.
void readControlPoint(const DicomData& point, const std::string& where, PlanBeam& beam)
{
  for (const Angle& angle : kAngles)
  {
    if (point.text(angle.tag).empty() && !point.number(angle.tag))
    {
      continue;
    }
    const std::vector<double> values = point.numbers(angle.tag);
    const double value = values.size() == 1 ? values.front() : NAN;
    if (!(std::abs(value) <= 360.0))
    {
      failRt(where, std::string(angle.name) + " is '" + point.text(angle.tag).substr(0, 40) +
                        "', expected degrees from -360 to 360");
    }
    beam.*angle.value = value;
  }
  if (!point.text(kIsocentre).empty())
  {
    const std::vector<double> values = point.numbers(kIsocentre);
    if (values.size() == 3)
    {
      beam.isocentre = Eigen::Vector3d(values.data());
    }
    // Negated so that NaN fails, too.
    if (values.size() != 3 || !(beam.isocentre.cwiseAbs().maxCoeff() <= kFarthest))
    {
      failRt(where, "IsocenterPosition (300A,012C) is '" + point.text(kIsocentre).substr(0, 80) +
                        "', expected three numbers x\\y\\z, mm within 10000 of the origin");
    }
  }
}

std::string positionOf(const DicomData& file, const DicomData& beam, const std::string& where)
{
  const std::vector<DicomData> setups = file.items(kSetups);
  const std::optional<double> number = beam.number(kReferencedSetup);
  std::vector<DicomData> found;
  std::copy_if(setups.begin(), setups.end(), std::back_inserter(found),
               [&](const DicomData& setup)
               { return (!number && setups.size() == 1) || (number && setup.number(kSetupNumber) == number); });
  if (found.size() != 1)
  {
    failRt(where, "ReferencedPatientSetupNumber (300C,006A) is " + (number ? beam.text(kReferencedSetup) : "absent") +
                      ", of which PatientSetupSequence (300A,0180) has " + std::to_string(found.size()) +
                      " among its " + std::to_string(setups.size()) + " items, expected 1");
  }
  const std::string position = found.front().text(kPatientPosition);
  if (tableTopsFromPatient().count(position) == 0)
  {
    std::string known;
    for (const auto& [name, matrix] : tableTopsFromPatient())
    {
      known += (known.empty() ? "" : ", ") + name;
    }
    failRt(where,
           "PatientPosition (0018,5100) is " + (position.empty() ? "absent" : position) + ", expected one of " + known);
  }
  return position;
}

PlanBeam readBeam(const DicomData& file, const DicomData& item, const std::string& path)
{
  PlanBeam beam;
  beam.number = static_cast<int>(std::clamp(item.number(kBeamNumber).value_or(-1.0), -1.0, 1e9));
  beam.name = rtName(file, item, kBeamName);
  const std::string where = path + ": beam " + item.text(kBeamNumber) + " '" + beam.name + "'";
  if (beam.number < 0)
  {
    failRt(where, "BeamNumber (300A,00C0) is " + (item.text(kBeamNumber).empty() ? "absent" : item.text(kBeamNumber)) +
                      ", expected a whole number");
  }
  const std::vector<DicomData> points = item.items(kControlPoints);
  beam.isocentre.setConstant(NAN);
  if (!points.empty())
  {
    readControlPoint(points.front(), where, beam);
    if (!points.front().number(kAngles[kCouch].tag))
    {
      failRt(where,
             std::string(kAngles[kCouch].name) +
                 " is absent or empty in its first control point, expected degrees: the patient lies turned by it");
    }
  }
  if (!beam.isocentre.allFinite())
  {
    failRt(where, std::string(points.empty() ? "ControlPointSequence (300A,0111)" : "IsocenterPosition (300A,012C)") +
                      " is absent or empty, expected the isocentre in its first control point");
  }
  beam.patient_position = positionOf(file, item, where);
  PlanBeam later = beam;
  for (const DicomData& point : points)
  {
    readControlPoint(point, where, later);
    if (!liesAlike(beam, later))
    {
      std::ostringstream message;
      message << "the patient moves during the beam: isocentre " << placeText(beam.isocentre) << " and "
              << placeText(later.isocentre) << " mm, couch " << beam.couch_angle << " and " << later.couch_angle
              << " degrees; expected one place for all its control points";
      failRt(where, message.str());
    }
  }
  return beam;
}

std::string listOf(const TreatmentPlan& plan)
{
  std::ostringstream list;
  for (const PlanBeam& beam : plan.beams)
  {
    list << "\n  --beam " << beam.number << "  # '" << beam.name << "', isocentre " << placeText(beam.isocentre)
         << " mm, " << beam.patient_position << ", gantry " << beam.gantry_angle << ", couch " << beam.couch_angle
         << " degrees";
    if (beam.eccentric_angle != 0.0 || beam.pitch_angle != 0.0 || beam.roll_angle != 0.0)
    {
      list << ", eccentric " << beam.eccentric_angle << ", pitch " << beam.pitch_angle << ", roll " << beam.roll_angle;
    }
  }
  return list.str();
}
}  // namespace

TreatmentPlan readTreatmentPlan(const std::string& path)
{
  const DicomData file = readRtFile(path, "RTPLAN");
  TreatmentPlan plan;
  plan.file = path;
  plan.frame_of_reference = file.text(kFrameOfReference);
  plan.patient_id = file.text(kPatientId);
  for (const DicomData& item : file.items(kStructureSets))
  {
    plan.structure_sets.push_back(item.text(kInstance));
  }
  for (const DicomData& item : file.items(kBeams))
  {
    try
    {
      plan.beams.push_back(readBeam(file, item, path));
    }
    catch (const std::runtime_error&)
    {
      // Beams for setup images have no isocentre in some plans, and treat nobody.
      if (item.text(kDeliveryType) != "SETUP")
      {
        throw;
      }
    }
  }
  if (plan.beams.empty())
  {
    failRt(path, "BeamSequence (300A,00B0) is absent or empty, expected a plan with beams");
  }
  return plan;
}

const PlanBeam& chosenBeam(const TreatmentPlan& plan, const std::optional<int>& number)
{
  const PlanBeam& first = plan.beams.front();
  if (!number)
  {
    if (!std::all_of(plan.beams.begin(), plan.beams.end(),
                     [&](const PlanBeam& beam) { return liesAlike(first, beam); }))
    {
      failRt(plan.file, "the patient does not lie alike for its " + std::to_string(plan.beams.size()) +
                            " beams, expected one to be chosen:" + listOf(plan));
    }
    return first;
  }
  const auto isNamed = [&](const PlanBeam& beam) { return beam.number == *number; };
  const auto found = std::find_if(plan.beams.begin(), plan.beams.end(), isNamed);
  if (std::count_if(plan.beams.begin(), plan.beams.end(), isNamed) != 1)
  {
    failRt(plan.file, (found == plan.beams.end() ? "no beam has" : "several beams have") +
                          std::string(" BeamNumber (300A,00C0) ") + std::to_string(*number) + ", expected one of" +
                          listOf(plan));
  }
  return *found;
}

RigidTransform roomFromPatient(const PlanBeam& beam)
{
  const auto turn = [](double degrees, const Eigen::Vector3d& axis)
  { return Eigen::AngleAxisd(degrees * kDegree, axis).toRotationMatrix(); };
  // docs/frames.md
  const Eigen::Matrix3d room_from_fixed = (Eigen::Matrix3d() << 0, 1, 0, -1, 0, 0, 0, 0, 1).finished();
  const Eigen::Matrix3d fixed_from_table_top = turn(beam.couch_angle + beam.eccentric_angle, Eigen::Vector3d::UnitZ()) *
                                               turn(beam.pitch_angle, Eigen::Vector3d::UnitX()) *
                                               turn(beam.roll_angle, Eigen::Vector3d::UnitY());
  RigidTransform room_from_patient = RigidTransform::Identity();
  room_from_patient.linear() =
      room_from_fixed * fixed_from_table_top * tableTopsFromPatient().at(beam.patient_position);
  room_from_patient.translation() = -(room_from_patient.linear() * beam.isocentre);
  return room_from_patient;
}

void requireOn(const TreatmentPlan& plan, const Structure& structure, const CtFrame& ct)
{
  // IDs themselves do not belong into logs.
  if (!plan.patient_id.empty() && !structure.patientId().empty() && plan.patient_id != structure.patientId())
  {
    failRt(plan.file, "its PatientID (0010,0020) is not that of " + structure.choice().file +
                          ", expected plan and structures of one patient");
  }
  if (plan.frame_of_reference.empty())
  {
    if (std::find(plan.structure_sets.begin(), plan.structure_sets.end(), structure.uid()) == plan.structure_sets.end())
    {
      failRt(plan.file,
             "FrameOfReferenceUID (0020,0052) is absent, and ReferencedStructureSetSequence (300C,0060) does "
             "not name the SOPInstanceUID (0008,0018) of " +
                 structure.choice().file + ", expected one of them: was the plan made on other structures?");
    }
  }
  else if (plan.frame_of_reference != ct.frame_of_reference)
  {
    failRt(plan.file, "its frame of reference (0020,0052) is " + plan.frame_of_reference + ", that of the CT " +
                          ct.path + " " + ct.frame_of_reference +
                          ": expected the same; the plan was made on another scan");
  }
}
}  // namespace xray_tracking
