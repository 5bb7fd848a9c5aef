#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>

#include <gtest/gtest.h>

#include "recorded_run.h"
#include "test_helpers.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_tools/exposure_set.h"

namespace xray_tracking
{
namespace
{
CommandResult run(const std::string& command)
{
  return runShell(std::string(COMMAND_DIR) + "/" + command);
}

bool contains(const std::string& text, const std::string& part)
{
  return text.find(part) != std::string::npos;
}

TEST(SequenceToBag, convertsAndShowsProgress)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const CommandResult result = run("sequence_to_bag " + folder.file("") + " " + folder.file("out.bag") + " --frames 3");
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_TRUE(contains(result.output, "exposure 3 / 3\n3 exposures, 0.5 s, detectors detector_a detector_b\n"))
      << result.output;
  EXPECT_TRUE(std::filesystem::exists(folder.file("out.bag")));
}

/// A flaw in a sequence folder and what the message must name.
struct Flaw
{
  const char* name;
  void (*make)(const TemporaryFolder& folder);
  const char* named;
};

class BadSequence : public testing::TestWithParam<Flaw>
{
};

TEST_P(BadSequence, endsWithOneLineAndNoBag)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  GetParam().make(folder);
  const CommandResult result = run("sequence_to_bag " + folder.file("") + " " + folder.file("out.bag"));
  EXPECT_EQ(1, result.status);
  const std::size_t message = result.output.find("sequence_to_bag: ");
  ASSERT_NE(std::string::npos, message) << result.output;
  EXPECT_TRUE(contains(result.output.substr(message), GetParam().named)) << result.output;
  EXPECT_EQ(result.output.size() - 1, result.output.find('\n', message)) << result.output;
  EXPECT_FALSE(std::filesystem::exists(folder.file("out.bag")));
  EXPECT_FALSE(std::filesystem::exists(folder.file("out.bag.partial")));
}

void writeFrames(const TemporaryFolder& folder, const std::string& rows)
{
  folder.write("frames.csv", "stamp_s,detector,file\n" + rows);
}

INSTANTIATE_TEST_SUITE_P(
    Flaws, BadSequence,
    testing::Values(
        Flaw{ "missingImage", [](const TemporaryFolder& f) { std::filesystem::remove(f.file("image_b3.png")); },
              "image_b3.png" },
        Flaw{ "wrongSize",
              [](const TemporaryFolder& f) { cv::imwrite(f.file("image_a4.png"), cv::Mat::zeros(7, 8, CV_16UC1)); },
              "image_a4.png" },
        Flaw{ "noImage", [](const TemporaryFolder& f) { f.write("image_a1.png", "not a picture"); }, "image_a1.png" },
        Flaw{ "outOfOrder",
              [](const TemporaryFolder& f) {
                writeFrames(f,
                            "0.5,detector_a,image_a0.png\n0.5,detector_b,image_b0.png\n0.25,detector_a,image_a1.png\n");
              },
              "frames.csv, line 4" },
        Flaw{ "silentDetector",
              [](const TemporaryFolder& f)
              { writeFrames(f, "0,detector_a,image_a0.png\n1,detector_a,image_a1.png\n"); },
              "detector_b" },
        Flaw{ "nanPose",
              [](const TemporaryFolder& f)
              { f.write("gold_standard.csv", "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n0,nan,0,0,0,0,0,1\n"); },
              "gold_standard.csv, line 2" },
        Flaw{ "noFolder", [](const TemporaryFolder& f) { std::filesystem::remove(f.file("sequence.yaml")); },
              "sequence.yaml" }),
    [](const testing::TestParamInfo<Flaw>& test) { return test.param.name; });

TEST(SequenceToBag, doesNotReplaceAGoodBagByAFailure)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  folder.write("out.bag", "precious");
  std::filesystem::remove(folder.file("image_a2.png"));
  EXPECT_EQ(1, run("sequence_to_bag " + folder.file("") + " " + folder.file("out.bag")).status);
  EXPECT_EQ(8U, std::filesystem::file_size(folder.file("out.bag")));
}

TEST(Observability, ofTwoOrthogonalViews)
{
  const TemporaryFolder folder;
  folder.write("setup.yaml", R"(
detectors: )" + coreConfigPath("geometry/cyberknife.yaml") +
                                 R"(
initial_pose: { translation_mm: [0, 0, 0], rotation_xyzw: [0, 0, 0, 1] }
target_box_mm: { min: [-25, -25, -25], max: [25, 25, 25] }
)");
  const CommandResult result = run("observability " + folder.file("setup.yaml"));
  EXPECT_EQ(0, result.status) << result.output;
  // A pixel of 0.4 mm at a magnification of 3800 / 2600 is 0.274 mm in the directions that one view sees.
  EXPECT_TRUE(contains(result.output, "with 0.274 mm a pixel, condition 1.41")) << result.output;
  EXPECT_TRUE(contains(result.output, "not seen")) << result.output;
  EXPECT_FALSE(
      contains(run("observability " + folder.file("setup.yaml") + " --model affine --bone").output, "not seen"));
  EXPECT_TRUE(contains(run("observability " + folder.file("setup.yaml") + " --model rigid").output, "'rigid'"));
}

TEST(SequenceToBag, explainsItsUse)
{
  EXPECT_EQ(0, run("sequence_to_bag --help").status);
  const CommandResult missing = run("sequence_to_bag folder");
  EXPECT_EQ(1, missing.status);
  EXPECT_TRUE(contains(missing.output, "OUT.bag is missing; usage: sequence_to_bag SEQUENCE_DIR")) << missing.output;
  EXPECT_EQ(1, run("sequence_to_bag a b --frames many").status);
  EXPECT_EQ(1, run("sequence_to_bag a b --fames 3").status);
}

std::vector<std::string> rowsOf(const std::string& path, const std::string& method)
{
  std::vector<std::string> rows;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);)
  {
    if (contains(line, "," + method + ","))
    {
      rows.push_back(line);
    }
  }
  return rows;
}

TEST(EvaluateBag, writesResultsAndNamesTheUnanswered)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);  // its sequence.yaml serves as the setup file
  writeTestRun(folder.file("run.bag"));
  const CommandResult result = run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("results") +
                                   " --setup " + folder.file("sequence.yaml"));
  EXPECT_EQ(1, result.status);
  EXPECT_TRUE(contains(result.output, "tracking")) << result.output;
  EXPECT_TRUE(contains(result.output, "frame 3 (53.0000 s) of tracking lost: detector_b lost its region\n"))
      << result.output;
  EXPECT_TRUE(contains(result.output, "frame 4 (54.0000 s) of tracking failed: no patient_motion\n")) << result.output;
  EXPECT_EQ(6U, rowsOf(folder.file("results/tre.csv"), "tracking").size());
  EXPECT_TRUE(std::filesystem::exists(folder.file("results/summary.json")));

  const CommandResult good = run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("good") + " --setup " +
                                 folder.file("sequence.yaml") + " --frames 3 --name first_three");
  EXPECT_EQ(0, good.status) << good.output;
  EXPECT_EQ(3U, rowsOf(folder.file("good/tre.csv"), "tracking").size());
  const CommandResult short_of = run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("short") +
                                     " --setup " + folder.file("sequence.yaml") + " --frames 7");
  EXPECT_EQ(1, short_of.status);
  EXPECT_TRUE(contains(short_of.output, "6 exposures were found, expected 7")) << short_of.output;
}

TEST(EvaluateBag, judgesARunThatRegistersByTheRegistration)
{
  using xray_tracking_msgs::PatientMotion;
  using xray_tracking_msgs::RefinementResult;
  const TemporaryFolder folder;
  writeTestSequence(folder);
  for (const bool last : { true, false })
  {
    RecordedRun recorded(folder.file("run.bag"), "tracking_and_registration");
    recorded.answer(ros::Time(50, 0), 1, 2, 3);
    if (last)
    {
      recorded.answer(ros::Time(51, 0), 1, 2, 3);
    }
    else
    {
      recorded.motion(ros::Time(51, 0), PatientMotion::LOST, "the views disagree");
    }
    // What the registration refuses was tracked.
    recorded.refined(ros::Time(50, 0), RefinementResult::SUCCESS, 1, 2, 3);
    recorded.refined(ros::Time(51, 0), RefinementResult::UNRELIABLE, 1, 2, 3);
    recorded.close();
    const CommandResult result = run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("results") +
                                     " --setup " + folder.file("sequence.yaml"));
    EXPECT_EQ(last ? 0 : 1, result.status) << result.output;
    EXPECT_EQ(!last,
              contains(result.output, "frame 1 (51.0000 s) of tracking_and_registration lost: the views disagree\n"))
        << result.output;
    EXPECT_TRUE(contains(result.output, "frame 1 (51.0000 s) of registration lost: status 1\n")) << result.output;
  }
}

TEST(EvaluateBag, saysThatNothingWasVerified)
{
  using xray_tracking_msgs::BeamGate;
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const auto evaluate = [&folder](const std::function<void(RecordedRun&)>& write)
  {
    RecordedRun recorded(folder.file("run.bag"));
    for (int k = 0; k < 3; ++k)
    {
      recorded.motion(ros::Time(50 + k, 0), xray_tracking_msgs::PatientMotion::OK);
      recorded.pose(ros::Time(50 + k, 0), 1, 2, 3);
    }
    write(recorded);
    recorded.close();
    return run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("results") + " --setup " +
               folder.file("sequence.yaml"));
  };
  CommandResult result = evaluate(
      [](RecordedRun& recorded)
      {
        recorded.gate(ros::Time(50, 0), false, BeamGate::UNVERIFIED, "no registration has confirmed the initial pose");
        recorded.gate(ros::Time(51, 0), false, BeamGate::NOT_MEASURED, "lost");
        recorded.gate(ros::Time(52, 0), false, BeamGate::UNVERIFIED, "3 refused since, the last one: flat optimum");
      });
  EXPECT_EQ(1, result.status);
  EXPECT_TRUE(contains(result.output, "beam gate: of 3 exposures 0 verified, open in 0\n")) << result.output;
  EXPECT_TRUE(contains(result.output,
                       "nothing was verified, the poses may all be wrong: 3 refused since, the last one: "
                       "flat optimum\n"))
      << result.output;
  result = evaluate(
      [](RecordedRun& recorded)
      {
        recorded.gate(ros::Time(51, 0), false, BeamGate::NO_EXPOSURE, "nothing so far");
        recorded.gate(ros::Time(51, 0), false, BeamGate::NOT_MEASURED, "lost");
        recorded.gate(ros::Time(51, 0), false, BeamGate::STALE, "the latest exposure is 2 s old");
      });
  EXPECT_EQ(1, result.status);
  EXPECT_TRUE(contains(result.output, "beam_gate never had a pose to judge: lost\n")) << result.output;
  result = evaluate([](RecordedRun&) {});
  EXPECT_EQ(1, result.status);
  EXPECT_TRUE(contains(result.output, "nothing was verified, the poses may all be wrong: the bag has no beam_gate\n"))
      << result.output;
  // A pose that is verified once the run is over is.
  result = evaluate(
      [](RecordedRun& recorded)
      {
        recorded.gate(ros::Time(51, 0), false, BeamGate::UNVERIFIED, "no registration has confirmed the initial pose");
        recorded.gate(ros::Time(52, 0), false, BeamGate::UNVERIFIED, "no registration has confirmed the initial pose");
        recorded.gate(ros::Time(52, 0), true, BeamGate::STALE, "the latest exposure is 2 s old");
      });
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_TRUE(contains(result.output, "beam gate: of 3 exposures 1 verified, open in 0\n")) << result.output;
}

TEST(EvaluateBag, writesTheSequencesStampsAndTheFirstPose)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  RecordedRun recorded(folder.file("run.bag"));
  for (int k = 0; k < 5; ++k)
  {
    recorded.answer(ros::Time(1000 + k / 4, 250000000 * (k % 4)), 10 + k, 20, 30);
  }
  recorded.close();
  const CommandResult result =
      run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("results") + " --sequence " + folder.file(""));
  EXPECT_EQ(0, result.status) << result.output;
  const std::vector<std::string> poses = rowsOf(folder.file("results/poses.csv"), "tracking");
  ASSERT_EQ(5U, poses.size());
  int frame = -1;
  double stamp = NAN, x = NAN, y = NAN;
  ASSERT_EQ(4, std::sscanf(poses[0].c_str(), "%d,%lf,tracking,%lf,%lf", &frame, &stamp, &x, &y));
  EXPECT_EQ(0, frame);
  EXPECT_NEAR(0.0, stamp, 1e-12);
  EXPECT_NEAR(10.0, x, 1e-6);
  ASSERT_EQ(4, std::sscanf(poses[3].c_str(), "%d,%lf,tracking,%lf,%lf", &frame, &stamp, &x, &y));
  EXPECT_NEAR(0.75, stamp, 1e-12);
  EXPECT_NEAR(13.0, x, 1e-6);
  EXPECT_NEAR(20.0, y, 1e-6);
}

TEST(EvaluateBag, endsOnBadInput)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  folder.write("broken.bag", "#ROSBAG V2.0\n");
  for (const std::string bag : { "none.bag", "broken.bag" })
  {
    const CommandResult result = run("evaluate_bag " + folder.file(bag) + " " + folder.file("results") + " --setup " +
                                     folder.file("sequence.yaml"));
    EXPECT_EQ(1, result.status);
    EXPECT_TRUE(contains(result.output, bag)) << result.output;
  }
  writeTestRun(folder.file("run.bag"));
  EXPECT_EQ(1, run("evaluate_bag " + folder.file("run.bag") + " " + folder.file("results")).status);
  EXPECT_FALSE(std::filesystem::exists(folder.file("results")));
}

/// Water with a bone ball of 8 mm radius at the given LPS point, 2 mm voxels, the middle at (100, -200, 300).
void writeTestCt(const std::string& path, const Eigen::Vector3d& ball)
{
  CtVolume ct;
  ct.grid.size = Eigen::Vector3i(40, 40, 40);
  ct.grid.patient_from_index.linear() = 2.0 * Eigen::Matrix3d::Identity();
  ct.grid.patient_from_index.translation() = Eigen::Vector3d(61, -239, 261);
  ct.hu.assign(ct.grid.voxelCount(), 0);
  for (int k = 0; k < 40; ++k)
  {
    for (int j = 0; j < 40; ++j)
    {
      for (int i = 0; i < 40; ++i)
      {
        const double distance = (ct.grid.patient_from_index * Eigen::Vector3d(i, j, k) - ball).norm();
        const bool outside = j < 3;
        ct.hu[ct.grid.offset(i, j, k)] = distance < 8.0 ? 900 : (outside ? -1000 : 0);
      }
    }
  }
  writeCtVolume(ct, path);
}

TEST(SetupFromCt, putsTheTargetIntoTheIsocentre)
{
  const TemporaryFolder folder;
  const Eigen::Vector3d ball(110, -195, 305);
  writeTestCt(folder.file("ct.nrrd"), ball);

  const CommandResult given = run("setup_from_ct " + folder.file("ct.nrrd") + " " + folder.file("given.yaml") +
                                  " --target 105 -190.5 299 --edge 30");
  ASSERT_EQ(0, given.status) << given.output;
  const TreatmentSetup setup = loadTreatmentSetup(folder.file("given.yaml"));
  const Eigen::Vector3d centre(105, -190.5, 299);
  EXPECT_LT((setup.targetCentre() - centre).norm(), 1e-9);
  EXPECT_LT((setup.target_box.sizes() - Eigen::Vector3d::Constant(30)).norm(), 1e-9);
  EXPECT_LT((setup.room_from_patient * centre).norm(), 1e-6);
  // Superior (LPS z) along room x, anterior (-y) up.
  EXPECT_LT((setup.room_from_patient.linear() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitX()).norm(), 1e-9);
  EXPECT_LT((setup.room_from_patient.linear() * -Eigen::Vector3d::UnitY() - Eigen::Vector3d::UnitZ()).norm(), 1e-9);
  EXPECT_EQ(2U, setup.detectors.size());
  EXPECT_EQ(IntensityModel::Kind::COUNTS, setup.intensity.kind);
  EXPECT_EQ(100.0, setup.intensity.offset);
  EXPECT_EQ(60000.0, setup.intensity.air_counts.value());
  EXPECT_EQ(std::filesystem::canonical(folder.file("ct.nrrd")).string(), setup.ct_path);

  const CommandResult found =
      run("setup_from_ct " + folder.file("ct.nrrd") + " " + folder.file("found.yaml") + " --edge 20");
  ASSERT_EQ(0, found.status) << found.output;
  // Any 20 mm cube that holds the whole ball has most bone: 2 mm of play each way, and a voxel.
  const TreatmentSetup searched = loadTreatmentSetup(folder.file("found.yaml"));
  EXPECT_LT((searched.targetCentre() - ball).cwiseAbs().maxCoeff(), 4.0);
}

TEST(SetupFromCt, endsOnBadInput)
{
  const TemporaryFolder folder;
  const std::string out = folder.file("out.yaml");
  const CommandResult missing = run("setup_from_ct " + folder.file("ct.nrrd") + " " + out);
  EXPECT_EQ(1, missing.status);
  EXPECT_TRUE(contains(missing.output, "ct.nrrd")) << missing.output;
  folder.write("ct.nrrd", "NRRD0004\ntruncated");
  EXPECT_EQ(1, run("setup_from_ct " + folder.file("ct.nrrd") + " " + out).status);
  EXPECT_TRUE(contains(run("setup_from_ct " + folder.file("ct.nrrd") + " " + out + " --target 1 2").output,
                       "--target has 2 values, expected 3"));
  // With a target, too, it has to be one of a CT.
  const auto given = [&](const std::string& ct, const std::string& options)
  { return run("setup_from_ct " + folder.file(ct) + " " + out + " --target " + options).output; };
  EXPECT_TRUE(contains(given("ct.nrrd", "105 -190.5 299"), "ct.nrrd"));
  writeTestCt(folder.file("good.nrrd"), Eigen::Vector3d(110, -195, 305));
  const char* const outside = "reaches from   61 -239  261 to  139 -161  339 mm: expected a point of it";
  for (const char* const options :
       { "105 190.5 299", "-105 -190.5 299", "0.105 -0.1905 0.299", "1e308 -190.5 299", "105 -190.5 299 --edge 3000" })
  {
    EXPECT_TRUE(contains(given("good.nrrd", options), outside)) << given("good.nrrd", options);
  }
  EXPECT_FALSE(std::filesystem::exists(out));
}

/// The neck phantom in two views as a sequence of one exposure, with its CT; the initial pose is 25 mm and 8 degrees
/// off.
/// @return the pose
RigidTransform writePhantomSequence(const TemporaryFolder& folder)
{
  const NeckPhantom phantom;
  TreatmentSetup setup = loadTreatmentSetup(coreConfigPath("phantom_neck.yaml"));
  setup.ct_path = folder.file("ct.nrrd");
  writeCtVolume(phantom.sampleCt(PhantomCtOptions()), setup.ct_path);
  const RigidTransform pose = setup.room_from_patient;
  std::string frames = "stamp_s,detector,file\n";
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    cv::Mat soft, bone, counts;
    phantom.lineIntegrals(detector, pose, pose, soft, bone);
    counts = -(soft * kWaterAttenuation + bone * kBoneAttenuation);
    cv::exp(counts, counts);
    counts.convertTo(counts, CV_16U, *setup.intensity.air_counts - setup.intensity.offset, setup.intensity.offset);
    cv::imwrite(folder.file(detector.name() + ".png"), counts);
    frames += "0," + detector.name() + ',' + detector.name() + ".png\n";
  }
  Twist off;
  off << 0.08, -0.1, 0.06, 15.0, -16.0, 12.0;
  setup.room_from_patient = motionAbout(pose * setup.targetCentre(), off) * pose;
  saveTreatmentSetup(setup, folder.file("sequence.yaml"));
  std::ofstream(folder.file("sequence.yaml"), std::ios::app) << "frames: frames.csv\n";
  folder.write("frames.csv", frames);
  return pose;
}

TEST(AlignSequence, findsTheFirstPoseOrSaysThatItDoesNot)
{
  const TemporaryFolder folder;
  const RigidTransform pose = writePhantomSequence(folder);
  const std::string out = folder.file("aligned.yaml");
  const CommandResult aligned = run("align_sequence " + folder.file("") + ' ' + out);
  ASSERT_EQ(0, aligned.status) << aligned.output;
  const std::size_t said = aligned.output.find("aligned: ");
  ASSERT_NE(said, std::string::npos) << aligned.output;
  double moved = 0.0;
  double turned = 0.0;
  ASSERT_EQ(2, std::sscanf(aligned.output.c_str() + said, "aligned: %lf mm and %lf degrees", &moved, &turned));
  EXPECT_NEAR(moved, 25.0, 0.3);
  EXPECT_NEAR(turned, 8.0, 0.3);
  EXPECT_TRUE(contains(aligned.output, "other places: ")) << aligned.output;
  // All else stays as it is.
  const TreatmentSetup before = loadTreatmentSetup(folder.file("sequence.yaml"));
  const TreatmentSetup after = loadTreatmentSetup(out);
  EXPECT_LT(targetRegistrationError(after.room_from_patient, pose, before.target_box), 0.3);
  EXPECT_EQ(before.ct_path, after.ct_path);
  EXPECT_EQ(before.detectors.size(), after.detectors.size());
  EXPECT_TRUE(before.target_box.isApprox(after.target_box));
  std::filesystem::remove(out);

  // 25 mm off, and only 15 allowed.
  const CommandResult bounded = run("align_sequence " + folder.file("") + ' ' + out + " --max_mm 15");
  EXPECT_EQ(1, bounded.status) << bounded.output;
  EXPECT_TRUE(contains(bounded.output, "align_sequence: the first exposure's pose was not found")) << bounded.output;
  EXPECT_TRUE(contains(bounded.output, "; the best is ")) << bounded.output;
  EXPECT_FALSE(std::filesystem::exists(out));
}

TEST(AlignSequence, endsOnBadInput)
{
  const TemporaryFolder folder;
  const std::string out = folder.file("aligned.yaml");
  const auto fails = [&](const std::string& options, const std::string& named)
  {
    const CommandResult result = run("align_sequence " + folder.file("") + ' ' + out + options);
    EXPECT_EQ(1, result.status) << named;
    EXPECT_TRUE(contains(result.output, named)) << result.output;
    EXPECT_FALSE(std::filesystem::exists(out));
  };
  fails("", "sequence.yaml");
  writeTestSequence(folder);
  fails("", "ct is absent");
  writePhantomSequence(folder);
  fails(" --max_mm 101", "101");
  fails(" --max_mm nan", "nan");
  fails(" --max_degrees 0", "0");
  cv::imwrite(folder.file("detector_a.png"), cv::Mat::zeros(512, 512, CV_16UC1));
  fails("", "detector_a");
  std::filesystem::remove(folder.file("ct.nrrd"));
  fails("", "ct.nrrd");
}

/// A camera of 8 x 6 pixels that looks at the room's origin from `z` mm on the side that `rotation` has it.
std::string mayaCam(const std::string& rotation, double z)
{
  std::ostringstream text;
  text << "image size\n8,6\n\ncamera matrix\n200,0,3.5\n0,200,2.5\n0,0,1\n\nrotation\n"
       << rotation << "\n\ntranslation\n0\n0\n"
       << z << "\n";
  return text.str();
}

TEST(ImportGeometry, keepsTheRestOfASequence)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  folder.write("a.txt", mayaCam("1,0,0\n0,-1,0\n0,0,-1", 900.0));
  folder.write("b.txt", mayaCam("1,0,0\n0,0,1\n0,-1,0", 900.0));
  const std::string views = " --views " + folder.file("a.txt") + ' ' + folder.file("b.txt");
  const std::string out = folder.file("out.yaml");
  const CommandResult result =
      run("import_geometry " + out + views + " --pitch 5 --into " + folder.file("sequence.yaml"));
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_TRUE(contains(result.output, "all views see [0, 0, 0] mm")) << result.output;
  EXPECT_TRUE(contains(result.output, "2 detectors written")) << result.output;
  const TreatmentSetup setup = loadTreatmentSetup(out);
  EXPECT_EQ(10.0, setup.room_from_patient.translation().x());
  EXPECT_LT((setup.detectors[1].source() - Eigen::Vector3d(0, 900, 0)).norm(), 1e-9);
  EXPECT_EQ("detector_b", setup.detectors[1].name());
  // The setup's own names are kept.
  folder.write("named.yaml",
               "detectors:\n"
               "- {name: cam1, image_size: [8, 6], pixel_pitch_mm: [0.5, 0.25], source_mm: [0, 0, 600],\n"
               "   origin_mm: [-1.5, 0.5, -400], x_direction: [1, 0, 0], y_direction: [0, -1, 0]}\n"
               "- {name: cam2, image_size: [8, 6], pixel_pitch_mm: [0.5, 0.25], source_mm: [0, 600, 0],\n"
               "   origin_mm: [-1.5, -400, -0.5], x_direction: [1, 0, 0], y_direction: [0, 0, 1]}\n");
  EXPECT_EQ(0, run("import_geometry " + out + views + " --pitch 5 --into " + folder.file("named.yaml")).status);
  EXPECT_EQ("cam2", loadDetectors(out)[1].name());

  // Alone it is no setup yet, and says so.
  const CommandResult alone = run("import_geometry " + out + views + " --sdd 1000 --names left right");
  EXPECT_EQ(0, alone.status);
  EXPECT_TRUE(contains(alone.output, "not yet a whole setup: ")) << alone.output;
  EXPECT_EQ("right", loadDetectors(out)[1].name());
}

TEST(ImportGeometry, tellsOfAnInvertedInitialPose)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  folder.write("a.txt", mayaCam("1,0,0\n0,-1,0\n0,0,-1", 900.0));
  folder.write("b.txt", mayaCam("1,0,0\n0,0,1\n0,-1,0", 900.0));
  // The target stands at -10, -20, -30 in the patient; the pose moves it there again.
  std::ifstream in(folder.file("sequence.yaml"));
  std::string text((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  text.replace(text.find("[10, 20, 30]"), 12, "[-10, -20, -30]");
  text.replace(text.find("min: [-12, -21, -31], max: [-8, -19, -29]"), 41,
               "min: [-10.5, -20.5, -30.5], max: [-9.5, -19.5, -29.5]");
  folder.write("sequence.yaml", text);
  const CommandResult result = run("import_geometry " + folder.file("out.yaml") + " --views " + folder.file("a.txt") +
                                   ' ' + folder.file("b.txt") + " --pitch 5 --into " + folder.file("sequence.yaml"));
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_TRUE(contains(result.output, "target_outside_image: detector_a")) << result.output;
  EXPECT_TRUE(contains(result.output, "by the inverse of it (it maps room to patient)")) << result.output;
  EXPECT_TRUE(contains(result.output, "translation_mm: [10, 20, 30] puts the target where")) << result.output;
}

TEST(ImportGeometry, endsOnBadInput)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  folder.write("a.txt", mayaCam("1,0,0\n0,-1,0\n0,0,-1", 900.0));
  folder.write("b.txt", mayaCam("1,0,0\n0,0,1\n0,-1,0", 900.0));
  const std::string out = folder.file("out.yaml");
  const auto fails = [&](const std::string& options, const std::string& named)
  {
    const CommandResult result = run("import_geometry " + out + ' ' + options);
    EXPECT_EQ(1, result.status) << named;
    EXPECT_TRUE(contains(result.output, named)) << result.output;
    EXPECT_EQ(result.output.size() - 1, result.output.find('\n')) << result.output;
    EXPECT_FALSE(std::filesystem::exists(out));
  };
  const std::string views = "--views " + folder.file("a.txt") + ' ' + folder.file("b.txt");
  fails("", "--views is missing");
  fails(views, "--pitch MM or --sdd MM");
  fails(views + " --pitch 5 --unit inch", "--unit is inch");
  fails(views + " --pitch 1 2 3", "--pitch has 3");
  fails(views + " --pitch -5", "");
  fails(views + " --sdd nan", "nan");
  fails(views + " --pitch 5 --point 1 2", "--point has 2");
  fails(views + " --pitch 5 --image_size 8", "--image_size has 1");
  fails(views + " --pitch 5 --into " + folder.file("none.yaml"), "none.yaml");
  fails("--views " + folder.file("none.txt") + " --pitch 5", "none.txt");
}

TEST(ShowSetup, drawsSetupsAndSequences)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const std::string out = folder.file("picture.png");
  CommandResult result = run("show_setup " + folder.file("") + ' ' + out);
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_FALSE(cv::imread(out).empty());
  std::filesystem::remove(out);

  // The picture's path may stand behind the images.
  result = run("show_setup " + folder.file("sequence.yaml") + " --images " + folder.file("image_a1.png") + ' ' +
               folder.file("image_b1.png") + ' ' + out);
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_FALSE(cv::imread(out).empty());

  writePhantomSequence(folder);
  std::filesystem::remove(out);
  result = run("show_setup " + folder.file("") + ' ' + out);
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_FALSE(cv::imread(out).empty());
}

TEST(ShowSetup, saysWhatIsTurnedOrMirrored)
{
  const TemporaryFolder folder;
  const RigidTransform pose = writePhantomSequence(folder);
  const std::string path = folder.file("sequence.yaml"), out = folder.file("picture.png");
  TreatmentSetup setup = loadTreatmentSetup(path);
  const std::string images = " --images " + folder.file("detector_a.png") + ' ' + folder.file("detector_b.png");
  const auto shown = [&](const RigidTransform& room_from_patient, const std::string& of)
  {
    setup.room_from_patient = room_from_patient;
    saveTreatmentSetup(setup, folder.file("setup.yaml"));
    const CommandResult result = run("show_setup " + folder.file("setup.yaml") + ' ' + out + of);
    EXPECT_EQ(0, result.status) << result.output;
    return result.output;
  };
  // The first pose is right: nothing but the two lines of progress.
  const std::string right = shown(pose, images);
  EXPECT_EQ(2, std::count(right.begin(), right.end(), '\n')) << right;

  const Eigen::Translation3d centre(setup.targetCentre());
  const RigidTransform prone = pose * centre * Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()) * centre.inverse();
  EXPECT_TRUE(contains(shown(prone, images), "turned by 180 degrees about his head-feet axis")) << shown(prone, images);
  EXPECT_TRUE(contains(shown(pose.inverse(), images), "the inverse of it")) << shown(pose.inverse(), images);
  RigidTransform off = pose;
  off.translation().x() += 16.0;
  EXPECT_TRUE(contains(shown(off, images), "16 mm (detector_a)")) << shown(off, images);

  cv::Mat mirrored;
  cv::flip(cv::imread(folder.file("detector_b.png"), cv::IMREAD_UNCHANGED), mirrored, 1);
  cv::imwrite(folder.file("mirrored.png"), mirrored);
  const std::string told =
      shown(pose, " --images " + folder.file("detector_a.png") + ' ' + folder.file("mirrored.png"));
  EXPECT_TRUE(contains(told, "the image of detector_b looks like its DRR when it is turned left to right")) << told;
  EXPECT_FALSE(contains(told, "the image of detector_a")) << told;
}

TEST(ShowSetup, endsOnBadInput)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const auto fails = [&](const std::string& options, const std::string& named)
  {
    const CommandResult result = run("show_setup " + options);
    EXPECT_EQ(1, result.status) << named;
    EXPECT_TRUE(contains(result.output, named)) << result.output;
  };
  const std::string setup = folder.file("sequence.yaml");
  fails(setup, "OUT.png is missing");
  fails(folder.file("none.yaml") + ' ' + folder.file("out.png"), "none.yaml");
  fails(setup + ' ' + folder.file("out.txt"), "out.txt: cannot be written");
  fails(setup + ' ' + folder.file("none/out.png"), "cannot be written");
  fails(setup + ' ' + folder.file("out.png") + " --images " + folder.file("image_a1.png"), "--images: 1");
  fails(setup + ' ' + folder.file("out.png") + " --images a.png b.png", "a.png");
}
}  // namespace
}  // namespace xray_tracking
