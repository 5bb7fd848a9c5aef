#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "rt_samples.h"
#include "test_helpers.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_tools/exposure_set.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector3d kIsocentre(12.5, -180.0, -431.0);
/// Of the target, beside the isocentre.
const Eigen::Vector3d kTarget(14.5, -176.0, -432.0);

/// CT, structure set and plan in one folder, as they are exported.
class SetupFromPlan : public testing::Test
{
protected:
  void SetUp() override
  {
    VolumeGrid grid;
    grid.size = { 24, 24, 30 };
    grid.patient_from_index.linear() = Eigen::Vector3d(4.0, 4.0, 2.0).asDiagonal();
    grid.patient_from_index.translation() = kTarget - 0.5 * Eigen::Vector3d(23 * 4, 23 * 4, 29 * 2);
    std::filesystem::create_directories(folder_.file("export"));
    for (int k = 0; k < grid.size.z(); ++k)
    {
      folder_.write("export/ct" + std::to_string(k) + ".dcm", ctSliceFile(grid, k));
    }
    SampleRoi vertebra{ 4, "T 7", {}, {} };
    for (double z = -9.0; z < 10.0; z += 2.0)
    {
      vertebra.contours.push_back(
          { circle(kTarget + Eigen::Vector3d(0, 0, z), 15.0, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY()) });
    }
    folder_.write("export/rs.dcm", structureSetFile({ { 1, "skin", {}, {} }, vertebra }));
    writePlan({ beam(1, 30.0) });
  }

  static SampleBeam beam(int number, double couch)
  {
    SampleBeam beam;
    beam.number = number;
    beam.isocentre = kIsocentre;
    beam.couch = couch;
    return beam;
  }

  void writePlan(const std::vector<SampleBeam>& beams, const DicomElements& others = {}) const
  {
    folder_.write("export/rp.dcm", planFile(beams, { "HFS" }, others));
  }

  CommandResult run(const std::string& options, const std::string& files = "rs.dcm rp.dcm") const
  {
    std::string paths;
    std::istringstream names(files);
    for (std::string name; names >> name;)
    {
      paths += folder_.file("export/" + name) + ' ';
    }
    return runShell(std::string(COMMAND_DIR) + "/setup_from_plan " + folder_.file("export") + ' ' + paths +
                    folder_.file("setup.yaml") + ' ' + options);
  }

  void expectRefused(const std::string& options, const std::vector<std::string>& parts,
                     const std::string& files = "rs.dcm rp.dcm") const
  {
    const CommandResult result = run(options, files);
    EXPECT_EQ(1, result.status) << options;
    for (const std::string& part : parts)
    {
      EXPECT_NE(std::string::npos, result.output.find(part)) << "'" << part << "' is missing in " << result.output;
    }
    EXPECT_FALSE(std::filesystem::exists(folder_.file("setup.yaml")));
  }

  TemporaryFolder folder_;
  const std::string detectors_ = "--detectors " + coreConfigPath("geometry/orthogonal_linac.yaml");
  const std::string all_ = "--roi 'T 7' " + detectors_;
};

TEST_F(SetupFromPlan, PutsTheIsocentreIntoTheRoomsOrigin)
{
  const CommandResult result = run(all_);
  ASSERT_EQ(0, result.status) << result.output;
  EXPECT_NE(std::string::npos, result.output.find("HFS, couch 30 degrees, isocentre 12.5 -180 -431 mm"))
      << result.output;
  EXPECT_NE(std::string::npos, result.output.find("'T 7' of")) << result.output;

  const TreatmentSetup setup = loadTreatmentSetup(folder_.file("setup.yaml"));
  EXPECT_EQ(std::filesystem::canonical(folder_.file("export")).string(), setup.ct_path);
  EXPECT_LT((setup.room_from_patient * kIsocentre).norm(), 1e-6);
  // 40 mm superior: with the couch at 0 along room x, turned by 30 degrees counter-clockwise as seen from above.
  const Eigen::Vector3d superior = setup.room_from_patient * (kIsocentre + Eigen::Vector3d(0, 0, 40));
  EXPECT_LT((superior - Eigen::Vector3d(40.0 * std::sqrt(0.75), 20.0, 0.0)).norm(), 1e-6) << superior.transpose();
  const Eigen::Vector3d anterior = setup.room_from_patient * (kIsocentre - Eigen::Vector3d(0, 10, 0));
  EXPECT_LT((anterior - Eigen::Vector3d(0, 0, 10)).norm(), 1e-6) << anterior.transpose();
  EXPECT_LT((setup.targetCentre() - kTarget).norm(), 0.002);
  EXPECT_LT((setup.target_box.sizes() - Eigen::Vector3d(30, 30, 20)).norm(), 0.01);
  ASSERT_TRUE(setup.target_structure);
  EXPECT_EQ("T 7", setup.target_structure->roi);
  EXPECT_EQ(2U, setup.detectors.size());
}

TEST_F(SetupFromPlan, Refused)
{
  expectRefused("--roi 'T 7'", { "--detectors FILE is missing", "import_geometry" });
  expectRefused(detectors_, { "rs.dcm", "'skin', 'T 7'" });
  expectRefused("--roi skin " + detectors_, { "rs.dcm", "'skin'", "no contours" });
  expectRefused("--roi 'T 7' --detectors nowhere.yaml", { "nowhere.yaml" });
  expectRefused(all_, { "no such file", "nothing.dcm" }, "nothing.dcm rp.dcm");
  expectRefused(all_, { "rs.dcm", "is RTSTRUCT", "expected RTPLAN" }, "rp.dcm rs.dcm");
  expectRefused(all_, { "rp.dcm", "is RTPLAN", "expected RTSTRUCT" }, "rp.dcm rp.dcm");

  writePlan({ beam(1, 0.0), beam(2, 30.0) });
  expectRefused(all_, { "rp.dcm", "--beam 1", "--beam 2", "couch 30" });
  expectRefused(all_ + " --beam 3", { "(300A,00C0) 3", "--beam 1", "--beam 2" });
  EXPECT_EQ(0, run(all_ + " --beam 2").status);
  std::filesystem::remove(folder_.file("setup.yaml"));

  writePlan({ beam(1, 0.0) }, { { { 0x20, 0x0052 }, { "UI", "1.2.3.99" } } });
  expectRefused(all_, { "rp.dcm", "1.2.3.99", kFrameUid, "another scan" });

  SampleBeam away = beam(1, 0.0);
  away.isocentre.x() += 900.0;
  writePlan({ away });
  expectRefused(all_, { "orthogonal_linac.yaml", "sees nothing of the target", "isocentre" });
}
}  // namespace
}  // namespace xray_tracking
