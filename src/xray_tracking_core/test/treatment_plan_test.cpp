#include "xray_tracking_core/plan/treatment_plan.h"

#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "rt_samples.h"
#include "test_helpers.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector3d kIsocentre(12.5, -180.0, -431.0);

class TreatmentPlanTest : public testing::Test
{
protected:
  TreatmentPlan read(const std::vector<SampleBeam>& beams, const std::vector<std::string>& positions = { "HFS" },
                     const DicomElements& others = {}) const
  {
    folder_.write("rp.dcm", planFile(beams, positions, others));
    return readTreatmentPlan(folder_.path("rp.dcm"));
  }

  RigidTransform pose(const std::string& position, const SampleBeam& beam) const
  {
    const TreatmentPlan plan = read({ beam }, { position });
    return roomFromPatient(chosenBeam(plan, std::nullopt));
  }

  void expectRefused(const std::vector<SampleBeam>& beams, const std::vector<std::string>& positions,
                     std::vector<std::string> parts, const DicomElements& others = {},
                     const std::optional<int>& number = std::nullopt) const
  {
    parts.insert(parts.begin(), folder_.path("rp.dcm"));
    expectError<std::runtime_error>([&] { chosenBeam(read(beams, positions, others), number); }, parts);
  }

  TemporaryFolder folder_;
};

Eigen::Matrix3d columns(const Eigen::Vector3d& left, const Eigen::Vector3d& posterior, const Eigen::Vector3d& superior)
{
  Eigen::Matrix3d matrix;
  matrix << left, posterior, superior;
  return matrix;
}

SampleBeam beamAt(double couch)
{
  SampleBeam beam;
  beam.isocentre = kIsocentre;
  beam.couch = couch;
  return beam;
}

/// Where the patient's left, posterior and superior point in the room (x to the gantry, z up, so y to the left of who
/// faces the gantry), written out by hand: decubitus right lies on the right side.
const std::map<std::string, Eigen::Matrix3d> kCouchAtZero{
  { "HFS", columns({ 0, -1, 0 }, { 0, 0, -1 }, { 1, 0, 0 }) },
  { "HFP", columns({ 0, 1, 0 }, { 0, 0, 1 }, { 1, 0, 0 }) },
  { "HFDR", columns({ 0, 0, 1 }, { 0, -1, 0 }, { 1, 0, 0 }) },
  { "HFDL", columns({ 0, 0, -1 }, { 0, 1, 0 }, { 1, 0, 0 }) },
  { "FFS", columns({ 0, 1, 0 }, { 0, 0, -1 }, { -1, 0, 0 }) },
  { "FFP", columns({ 0, -1, 0 }, { 0, 0, 1 }, { -1, 0, 0 }) },
  { "FFDR", columns({ 0, 0, 1 }, { 0, 1, 0 }, { -1, 0, 0 }) },
  { "FFDL", columns({ 0, 0, -1 }, { 0, -1, 0 }, { -1, 0, 0 }) },
};

/// The couch turned by 90 degrees, counter-clockwise as seen from above: what pointed to the gantry (x) points to the
/// left of who faces it (y).
const std::map<std::string, Eigen::Matrix3d> kCouchAtNinety{
  { "HFS", columns({ 1, 0, 0 }, { 0, 0, -1 }, { 0, 1, 0 }) },
  { "HFP", columns({ -1, 0, 0 }, { 0, 0, 1 }, { 0, 1, 0 }) },
  { "HFDR", columns({ 0, 0, 1 }, { 1, 0, 0 }, { 0, 1, 0 }) },
  { "HFDL", columns({ 0, 0, -1 }, { -1, 0, 0 }, { 0, 1, 0 }) },
  { "FFS", columns({ -1, 0, 0 }, { 0, 0, -1 }, { 0, -1, 0 }) },
  { "FFP", columns({ 1, 0, 0 }, { 0, 0, 1 }, { 0, -1, 0 }) },
  { "FFDR", columns({ 0, 0, 1 }, { -1, 0, 0 }, { 0, -1, 0 }) },
  { "FFDL", columns({ 0, 0, -1 }, { 1, 0, 0 }, { 0, -1, 0 }) },
};

TEST_F(TreatmentPlanTest, PatientPositionsAndCouchAngles)
{
  for (const auto& [position, expected] : kCouchAtZero)
  {
    for (const double couch : { 0.0, 90.0, 180.0, 270.0, -90.0, 360.0, 30.0, 342.5 })
    {
      SCOPED_TRACE(position + " " + std::to_string(couch));
      const RigidTransform room_from_patient = pose(position, beamAt(couch));
      EXPECT_TRUE(isRigid(room_from_patient));
      EXPECT_NEAR((room_from_patient * kIsocentre).norm(), 0.0, 1e-9);
      // Between the two by what a turn about the vertical makes of either.
      const double turn = couch * std::acos(-1.0) / 180.0;
      Eigen::Matrix3d turned = std::cos(turn) * expected + std::sin(turn) * kCouchAtNinety.at(position);
      turned.row(2) = expected.row(2);
      EXPECT_NEAR((room_from_patient.linear() - turned).norm(), 0.0, 1e-9) << room_from_patient.linear();
    }
  }
}

/// The example of docs/geometry.md.
TEST_F(TreatmentPlanTest, WorkedExample)
{
  const RigidTransform room_from_patient = pose("HFS", beamAt(30.0));
  // 10 mm to the left and 40 mm superior of the isocentre.
  const Eigen::Vector3d point(22.5, -180.0, -391.0);
  EXPECT_NEAR((room_from_patient * point - Eigen::Vector3d(39.641, 11.340, 0.0)).norm(), 0.0, 1e-3);
  EXPECT_NEAR((room_from_patient.translation() - Eigen::Vector3d(367.007, 226.325, -180.0)).norm(), 0.0, 1e-3);
  // Half turns are the same, so are q and -q.
  const Eigen::Quaterniond rotation(room_from_patient.linear());
  EXPECT_NEAR(std::abs(rotation.dot(Eigen::Quaterniond(0.612372, -0.612372, 0.353553, -0.353553))), 1.0, 1e-5)
      << rotation.coeffs().transpose();
}

TEST_F(TreatmentPlanTest, EccentricPitchAndRoll)
{
  const auto turned = [&](double couch, double eccentric, double pitch, double roll)
  {
    SampleBeam beam = beamAt(couch);
    beam.others = { { { 0x300a, 0x0125 }, { "DS", joined({ eccentric }) } },
                    { { 0x300a, 0x0140 }, { "FL", bytesOf({ static_cast<float>(pitch) }) } },
                    { { 0x300a, 0x0144 }, { "FL", bytesOf({ static_cast<float>(roll) }) } } };
    const RigidTransform room_from_patient = pose("HFS", beam);
    EXPECT_NEAR((room_from_patient * kIsocentre).norm(), 0.0, 1e-9);
    return Eigen::Matrix3d(room_from_patient.linear());
  };
  const Eigen::Vector3d left(1, 0, 0), posterior(0, 1, 0), superior(0, 0, 1);
  EXPECT_NEAR((turned(20, 10, 0, 0) - pose("HFS", beamAt(30.0)).linear()).norm(), 0.0, 1e-6);
  // Pitch lifts the head, roll lowers the left side.
  const double c = std::cos(3.0 * M_PI / 180.0), s = std::sin(3.0 * M_PI / 180.0);
  EXPECT_NEAR((turned(0, 0, 3, 0) * superior - Eigen::Vector3d(c, 0, s)).norm(), 0.0, 1e-6);
  EXPECT_NEAR((turned(0, 0, 357, 0) * superior - Eigen::Vector3d(c, 0, -s)).norm(), 0.0, 1e-6);
  EXPECT_NEAR((turned(0, 0, 0, 3) * left - Eigen::Vector3d(0, -c, -s)).norm(), 0.0, 1e-6);
  // Roll is about the pitched axis: the head stays where pitch has it.
  const double d = std::cos(2.0 * M_PI / 180.0), t = std::sin(2.0 * M_PI / 180.0);
  EXPECT_NEAR((turned(0, 0, 2, 3) * superior - Eigen::Vector3d(d, 0, t)).norm(), 0.0, 1e-6);
  EXPECT_NEAR((turned(0, 0, 2, 3) * -posterior - Eigen::Vector3d(-t * c, -s, d * c)).norm(), 0.0, 1e-6);
}

TEST_F(TreatmentPlanTest, BeamsToChoose)
{
  SampleBeam first = beamAt(0.0), second = beamAt(360.0), third = beamAt(45.0);
  second.number = 2;
  second.gantry = 90.0;
  third.number = 5;
  // Alike but for the gantry: any.
  EXPECT_EQ(chosenBeam(read({ first, second }), std::nullopt).number, 1);
  EXPECT_EQ(chosenBeam(read({ first, second }), std::nullopt).gantry_angle, 0.0);
  expectRefused({ first, second, third }, { "HFS" },
                { "3 beams", "--beam 1", "--beam 2", "--beam 5", "'field 5'", "isocentre 12.5 -180 -431", "couch 45" });
  EXPECT_EQ(chosenBeam(read({ first, second, third }), 5).couch_angle, 45.0);
  expectRefused({ first, third }, { "HFS" }, { "(300A,00C0) 4", "--beam 1", "--beam 5" }, {}, 4);
  SampleBeam other = first;
  other.number = 7;
  other.isocentre.z() += 30.0;
  expectRefused({ first, other }, { "HFS" }, { "--beam 7", "isocentre 12.5 -180 -401" });
  other = first;
  other.setup = 2;
  expectRefused({ first, other }, { "HFS", "FFS" }, { "FFS" });
  expectRefused({ first, other }, { "HFS", "FFS" }, { "several beams" }, {}, 1);
}

TEST_F(TreatmentPlanTest, Refused)
{
  const SampleBeam good = beamAt(0.0);
  read({ good });
  const auto first = [&](const DicomElements& others)
  {
    SampleBeam beam = good;
    beam.others = others;
    return std::vector<SampleBeam>{ beam };
  };
  const auto later = [&](const DicomElements& others)
  {
    SampleBeam beam = good;
    beam.later = others;
    return std::vector<SampleBeam>{ beam };
  };
  const std::string beam = "beam 1 'field 1'";
  expectRefused({}, { "HFS" }, { "(300A,00B0)", "absent or empty" });
  expectRefused(first({ { { 0x300a, 0x012c }, { "DS", "" } } }), { "HFS" }, { beam, "(300A,012C)", "absent" });
  expectRefused(first({ { { 0x300a, 0x012c }, { "DS", "1\\2" } } }), { "HFS" },
                { beam, "(300A,012C)", "1\\2", "three" });
  expectRefused(first({ { { 0x300a, 0x012c }, { "DS", "1\\2\\nan" } } }), { "HFS" }, { beam, "(300A,012C)", "nan" });
  expectRefused(first({ { { 0x300a, 0x012c }, { "DS", "1\\2\\1e9" } } }), { "HFS" }, { beam, "(300A,012C)", "1e9" });
  expectRefused(first({ { { 0x300a, 0x0122 }, { "DS", "left" } } }), { "HFS" }, { beam, "(300A,0122)", "left" });
  expectRefused(first({ { { 0x300a, 0x0122 }, { "DS", "" } } }), { "HFS" }, { beam, "(300A,0122)", "absent or empty" });
  expectRefused(first({ { { 0x300a, 0x0122 }, { "DS", "0\\30" } } }), { "HFS" }, { beam, "(300A,0122)", "0\\30" });
  expectRefused(first({ { { 0x300a, 0x0122 }, { "DS", "3600" } } }), { "HFS" }, { beam, "(300A,0122)", "3600" });
  expectRefused(first({ { { 0x300a, 0x0140 }, { "FL", bytesOf({ std::numeric_limits<float>::quiet_NaN() }) } } }),
                { "HFS" }, { beam, "(300A,0140)", "-360 to 360" });
  expectRefused(later({ { { 0x300a, 0x0122 }, { "DS", "30" } } }), { "HFS" }, { beam, "moves during", "0 and 30" });
  expectRefused(later({ { { 0x300a, 0x012c }, { "DS", "0\\0\\0" } } }), { "HFS" }, { beam, "moves during" });
  read(later({ { { 0x300a, 0x011e }, { "DS", "179" } } }));  // an arc
  expectRefused({ good }, { "SITTING" }, { beam, "(0018,5100) is SITTING", "HFDR" });
  expectRefused({ good }, { "" }, { beam, "(0018,5100) is absent" });
  expectRefused({ good }, {}, { beam, "(300C,006A) is 1", "(300A,0180)" });
  SampleBeam without = good;
  without.setup.reset();
  read({ without });
  expectRefused({ without }, { "HFS", "FFS" }, { beam, "(300C,006A) is absent", "2 items" });

  expectRefused({ good }, { "HFS" }, { "(0008,0060) is RTSTRUCT, a structure set", "expected RTPLAN" },
                { { { 8, 0x0060 }, { "CS", "RTSTRUCT" } } });
  expectRefused({ good }, { "HFS" }, { "(0008,0016)", "ion plan" },
                { { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.481.8" } } });
  const std::string whole = planFile({ good });
  for (std::size_t size = 0; size < whole.size(); ++size)
  {
    folder_.write("rp.dcm", whole.substr(0, size));
    expectError<std::runtime_error>([&] { readTreatmentPlan(folder_.path("rp.dcm")); }, { "rp.dcm" });
  }
}

TEST_F(TreatmentPlanTest, OnTheSameScan)
{
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  folder_.write("rs.dcm",
                structureSetFile(
                    { { 1, "bone", { { circle(kIsocentre, 9.0, x, y) }, { circle(kIsocentre + z, 9.0, x, y) } } } }));
  const Structure structure = Structure::read({ folder_.path("rs.dcm"), "bone" });
  const CtFrame ct{ "the CT", {}, kFrameUid };
  const SampleBeam beam = beamAt(0.0);
  requireOn(read({ beam }), structure, ct);
  expectError<std::runtime_error>(
      [&] {
        requireOn(read({ beam }, { "HFS" }, { { { 0x20, 0x0052 }, { "UI", "1.2.3.99" } } }), structure, ct);
      },
      { "rp.dcm", "1.2.3.99", "the CT", kFrameUid + ":" });
  // Frames of reference may be alike by mistake, patients may not; a file without an ID is nobody's.
  folder_.write(
      "rs.dcm",
      structureSetFile({ { 1, "bone", { { circle(kIsocentre, 9.0, x, y) }, { circle(kIsocentre + z, 9.0, x, y) } } } },
                       { { { 0x10, 0x0020 }, { "LO", "A1" } } }));
  const Structure of_a = Structure::read({ folder_.path("rs.dcm"), "bone" });
  requireOn(read({ beam }, { "HFS" }, { { { 0x10, 0x0020 }, { "LO", "A1" } } }), of_a, ct);
  requireOn(read({ beam }, { "HFS" }, { { { 0x10, 0x0020 }, { "LO", "" } } }), of_a, ct);
  expectError<std::runtime_error>(
      [&] {
        requireOn(read({ beam }, { "HFS" }, { { { 0x10, 0x0020 }, { "LO", "B2" } } }), of_a, ct);
      },
      { "rp.dcm", "PatientID (0010,0020)", "rs.dcm", "one patient" });
  // Plans without a frame of reference name the structure set.
  const auto old_plan = [&](const std::string& uid)
  {
    return read({ beam }, { "HFS" },
                { { { 0x20, 0x0052 }, { "UI", "" } },
                  { { 0x300c, 0x0060 }, { "SQ", dicomItem({ { { 8, 0x1155 }, { "UI", uid } } }) } } });
  };
  requireOn(old_plan(kStructureSetUid), structure, ct);
  expectError<std::runtime_error>([&] { requireOn(old_plan("1.2.3.78"), structure, ct); },
                                  { "rp.dcm", "(0020,0052) is absent", "(300C,0060)", "rs.dcm" });
}
}  // namespace
}  // namespace xray_tracking
