#include "xray_tracking_tools/recording_check.h"

#include <cmath>
#include <cstdlib>
#include <functional>
#include <set>

#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <sensor_msgs/Image.h>
#include <std_msgs/String.h>
#include <nlohmann/json.hpp>

#include "test_helpers.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_tools/exposure_set.h"
#include "xray_tracking_tools/image_message.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
constexpr int kExposures = 6;
constexpr int kEdge = 256;  // [px]
const char* const kNames[] = { "detector_a", "detector_b" };

template <typename Message>
struct Recorded
{
  ros::Time time;
  Message message;
};

/// What a bag is made of; good, until a test spoils it.
struct Good
{
  TreatmentSetup setup;
  std::vector<Recorded<sensor_msgs::Image>> images[2];
  std::vector<Recorded<sensor_msgs::CameraInfo>> infos[2];
  std::vector<Recorded<geometry_msgs::PoseStamped>> truth;
  tf2_msgs::TFMessage tf;
  std::string image_topics[2] = { "/room/detector_a/image_raw", "/room/detector_b/image_raw" };
  std::function<void(rosbag::Bag&)> more = [](rosbag::Bag&) {};

  cv::Mat pixels(int detector, int exposure)
  {
    return { kEdge, kEdge, CV_16UC1, images[detector][static_cast<std::size_t>(exposure)].message.data.data() };
  }

  void write(const std::string& path) const
  {
    rosbag::Bag bag(path, rosbag::bagmode::Write);
    bag.write("/tf_static", ros::Time(99, 0), tf);
    for (int d = 0; d < 2; ++d)
    {
      for (const auto& image : images[d])
      {
        bag.write(image_topics[d], image.time, image.message);
      }
      for (const auto& info : infos[d])
      {
        bag.write(std::string("/room/") + kNames[d] + "/camera_info", info.time, info.message);
      }
    }
    for (const auto& pose : truth)
    {
      bag.write("/room/patient_ground_truth", pose.time, pose.message);
    }
    more(bag);
    bag.close();
  }
};

/// The phantom moving by 0.5 mm an exposure, at 5 Hz from 100 s on, with quantum noise. Its patient frame's origin is
/// far from the target, as a scanner's is.
Good makeGood()
{
  const NeckPhantom phantom;
  const Eigen::Vector3d origin(-20.0, 220.0, -553.0);
  Good good;
  good.setup = loadTreatmentSetup(coreConfigPath("phantom_neck.yaml"));
  std::vector<ProjectionGeometry> detectors;
  for (const ProjectionGeometry& detector : good.setup.detectors)
  {
    DetectorDescription description = detector.description();
    description.origin += 0.5 * description.pixel_pitch.x() * description.x_direction +
                          0.5 * description.pixel_pitch.y() * description.y_direction;
    description.image_size = { kEdge, kEdge };
    description.pixel_pitch *= 2.0;
    detectors.push_back(ProjectionGeometry::fromDescription(description));
  }
  good.setup.detectors = detectors;
  good.setup.target_box.translate(origin);
  const RigidTransform phantom_pose = good.setup.room_from_patient;
  good.setup.room_from_patient = phantom_pose * Eigen::Translation3d(-origin);
  cv::RNG random(7);
  for (int k = 0; k < kExposures; ++k)
  {
    const ros::Time stamp(100 + k / 5, 200000000 * (k % 5));
    const RigidTransform moved = Eigen::Translation3d(0.5 * k, -0.3 * k, 0.2 * k) * phantom_pose;
    for (int d = 0; d < 2; ++d)
    {
      cv::Mat soft, bone, counts, noise(kEdge, kEdge, CV_32FC1), deviation, image;
      phantom.lineIntegrals(detectors[static_cast<std::size_t>(d)], moved, moved, soft, bone);
      counts = -(soft * kWaterAttenuation + bone * kBoneAttenuation);
      cv::exp(counts, counts);
      counts *= *good.setup.intensity.air_counts - good.setup.intensity.offset;
      random.fill(noise, cv::RNG::NORMAL, 0.0, 1.0);
      cv::sqrt(counts, deviation);
      counts += noise.mul(deviation) + good.setup.intensity.offset;
      counts.convertTo(image, CV_16UC1);
      good.images[d].push_back({ stamp + ros::Duration(0.05), imageMessage(image, kNames[d], stamp) });
      sensor_msgs::CameraInfo info = cameraInfoFromGeometry(detectors[static_cast<std::size_t>(d)]);
      info.header.stamp = stamp;
      good.infos[d].push_back({ stamp + ros::Duration(0.05), info });
    }
    geometry_msgs::PoseStamped truth;
    truth.header.stamp = stamp;
    truth.pose = poseMsgFromRigid(moved * Eigen::Translation3d(-origin));
    good.truth.push_back({ stamp + ros::Duration(0.05), truth });
  }
  for (const ProjectionGeometry& detector : detectors)
  {
    geometry_msgs::TransformStamped transform;
    transform.header.frame_id = kRoomFrame;
    transform.child_frame_id = opticalFrame(detector.name());
    transform.transform = transformMsgFromRigid(detector.roomFromOptical());
    good.tf.transforms.push_back(transform);
  }
  return good;
}

/// Its CT, in the same patient frame.
void writeCt(const std::string& path)
{
  CtVolume ct = NeckPhantom().sampleCt(PhantomCtOptions());
  ct.grid.patient_from_index.pretranslate(Eigen::Vector3d(-20.0, 220.0, -553.0));
  writeCtVolume(ct, path);
}

const Good& good()
{
  static const Good made = makeGood();
  return made;
}

std::set<std::string> codesOf(const std::vector<Finding>& findings)
{
  std::set<std::string> codes;
  for (const Finding& finding : findings)
  {
    codes.insert(finding.code);
  }
  return codes;
}

std::string linesOf(const std::vector<Finding>& findings)
{
  std::string lines;
  for (const Finding& finding : findings)
  {
    lines += lineOf(finding) + "\n";
  }
  return lines;
}

std::vector<Finding> check(const TemporaryFolder& folder, const Good& made)
{
  made.write(folder.file("x.bag"));
  saveTreatmentSetup(made.setup, folder.file("setup.yaml"));
  return checkBag(folder.file("x.bag"), folder.file("setup.yaml"));
}

/// A defect, the codes of what has to be found, and words of it.
struct Defect
{
  const char* name;
  void (*make)(Good& good);
  std::set<std::string> codes;
  const char* words;
};

class DefectOfABag : public testing::TestWithParam<Defect>
{
};

TEST_P(DefectOfABag, IsFoundAndNothingElse)
{
  const TemporaryFolder folder;
  Good spoilt = good();
  GetParam().make(spoilt);
  const std::vector<Finding> findings = check(folder, spoilt);
  std::set<std::string> expected = GetParam().codes;
  expected.insert("ct_missing");  // in all of these
  EXPECT_EQ(expected, codesOf(findings)) << linesOf(findings);
  EXPECT_NE(std::string::npos, linesOf(findings).find(GetParam().words)) << linesOf(findings);
}

/// Moves stamp and camera_info of detector_b's exposure.
void restamp(Good& g, int k, const ros::Duration& by)
{
  const auto at = static_cast<std::size_t>(k);
  g.images[1][at].message.header.stamp += by;
  g.infos[1][at].message.header.stamp += by;
}

INSTANTIATE_TEST_SUITE_P(
    Defects, DefectOfABag,
    testing::Values(
        Defect{ "noneButTheCt", [](Good&) {}, {}, "ct_missing" },
        Defect{ "noImages", [](Good& g) { g.images[1].clear(); }, { "topic_missing" }, "detector_b/image_raw: has no" },
        Defect{ "noCameraInfo",
                [](Good& g) { g.infos[0].clear(); },
                { "topic_missing" },
                "detector_a/camera_info: has no" },
        Defect{ "imagesOfAnotherType",
                [](Good& g)
                {
                  g.images[1].clear();
                  g.more = [](rosbag::Bag& bag)
                  { bag.write("/room/detector_b/image_raw", ros::Time(100, 0), std_msgs::String()); };
                },
                { "topic_missing", "topic_type" },
                "is std_msgs/String" },
        Defect{ "unknownDetector",
                [](Good& g) { g.image_topics[1] = "/room/detector_c/image_raw"; },
                { "topic_missing", "detector_unknown" },
                "detector_c" },
        Defect{ "offByMilliseconds",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    restamp(g, k, ros::Duration(0.004));
                  }
                },
                { "unpaired" },
                "6 of 6 stamps are 0.004000 s (median)" },
        Defect{ "oneImageLost",
                [](Good& g)
                {
                  g.images[1].erase(g.images[1].begin() + 3);
                  g.infos[1].erase(g.infos[1].begin() + 3);
                },
                { "image_missing" },
                "none for 1 of 6 exposures of detector_a, the first at 100.600000000 s" },
        Defect{ "gap",
                [](Good& g)
                {
                  for (int d = 0; d < 2; ++d)
                  {
                    for (std::size_t k = 4; k < kExposures; ++k)
                    {
                      g.images[d][k].message.header.stamp += ros::Duration(3.0);
                      g.images[d][k].time += ros::Duration(3.0);
                      g.infos[d][k].message.header.stamp += ros::Duration(3.0);
                      g.truth[k].message.header.stamp = g.infos[d][k].message.header.stamp;
                    }
                  }
                },
                { "gap" },
                "the longest 3.200 s after 100.600000000 s" },
        Defect{ "backwardTime",
                [](Good& g) { std::swap(g.images[0][2].time, g.images[0][3].time); },
                { "time_backward" },
                "by 0.200000 s" },
        Defect{ "repeatedStamp",
                [](Good& g)
                {
                  auto again = g.images[0][2];
                  cv::Mat pixels(kEdge, kEdge, CV_16UC1, again.message.data.data());
                  cv::Mat noise(kEdge, kEdge, CV_16UC1);
                  cv::RNG(3).fill(noise, cv::RNG::UNIFORM, 0, 16);
                  pixels += noise;
                  again.time += ros::Duration(0.01);
                  g.images[0].insert(g.images[0].begin() + 3, again);
                },
                { "stamp_repeated" },
                "1 of 7" },
        Defect{ "noStamp",
                [](Good& g)
                {
                  for (int d = 0; d < 2; ++d)
                  {
                    g.images[d][0].message.header.stamp = ros::Time();
                    g.infos[d][0].message.header.stamp = ros::Time();
                  }
                  g.truth[0].message.header.stamp = ros::Time();
                },
                { "stamp_zero", "gap" },
                "no time" },
        Defect{ "aheadOfTheClock",
                [](Good& g)
                {
                  for (int d = 0; d < 2; ++d)
                  {
                    for (auto& image : g.images[d])
                    {
                      image.time -= ros::Duration(30.0);
                    }
                  }
                },
                { "stamp_ahead" },
                "by 29.950 s" },
        Defect{ "behindTheClock",
                [](Good& g)
                {
                  for (auto& image : g.images[0])
                  {
                    image.time += ros::Duration(5.0);
                  }
                },
                { "stamp_behind" },
                "by 5.050 s" },
        Defect{ "cameraInfoOfAnotherTime",
                [](Good& g)
                {
                  for (auto& info : g.infos[0])
                  {
                    info.message.header.stamp += ros::Duration(0.001);
                  }
                },
                { "camera_info_unpaired" },
                "nearest is 0.001000 s off" },
        Defect{ "cameraInfoChanges",
                [](Good& g)
                {
                  g.infos[0][4].message.K[0] += 20.0;
                  g.infos[0][4].message.P[0] += 20.0;
                },
                { "camera_info_changed", "camera_info_differs" },
                "fx is 4770.0000 px, in the first one 4750.0000" },
        Defect{ "cameraInfosSwapped",
                [](Good& g)
                {
                  g.setup.detectors[1] = [&]
                  {
                    DetectorDescription other = g.setup.detectors[1].description();
                    other.origin += 4.0 * other.x_direction;
                    return ProjectionGeometry::fromDescription(other);
                  }();
                  g.tf.transforms.clear();
                  for (auto& info : g.infos[1])
                  {
                    const ros::Time stamp = info.message.header.stamp;
                    info.message = g.infos[0][0].message;
                    info.message.header.stamp = stamp;
                    info.message.header.frame_id = "detector_b_optical_frame";
                  }
                },
                { "camera_info_differs" },
                "it is that of detector_a: are the detectors swapped?" },
        Defect{ "distorted",
                [](Good& g)
                {
                  for (auto& info : g.infos[1])
                  {
                    info.message.D[0] = 0.1;
                  }
                },
                { "camera_info_invalid" },
                "detector_b/camera_info: 6 of 6" },
        Defect{ "binned",
                [](Good& g)
                {
                  for (auto& info : g.infos[0])
                  {
                    info.message.binning_x = 2;
                    info.message.binning_y = 2;
                  }
                },
                { "camera_info_invalid" },
                "binning_x" },
        Defect{ "stuckPixels",
                [](Good& g)
                {
                  // 3 % of them, apart from each other: every 6th of every 6th row.
                  for (int k = 0; k < kExposures; ++k)
                  {
                    for (int y = 2; y < kEdge; y += 6)
                    {
                      for (int x = 2; x < kEdge; x += 6)
                      {
                        g.pixels(0, k).at<std::uint16_t>(y, x) = 40;
                      }
                    }
                  }
                },
                { "image_stuck" },
                "stuck or written over" },
        Defect{ "otherFrame",
                [](Good& g)
                {
                  for (auto& info : g.infos[1])
                  {
                    info.message.header.frame_id = "camera";
                  }
                },
                { "camera_info_frame" },
                "frame_id is 'camera'" },
        Defect{ "tfElsewhere",
                [](Good& g) { g.tf.transforms[0].transform.translation.x += 0.002; },
                { "tf_differs" },
                "2.000 mm and 0.0000 degrees" },
        Defect{ "colour",
                [](Good& g)
                {
                  for (auto& image : g.images[0])
                  {
                    image.message.encoding = "rgb8";
                  }
                },
                { "image_encoding" },
                "encoding is 'rgb8'" },
        Defect{ "truncated",
                [](Good& g) { g.images[0][1].message.data.resize(1000); },
                { "image_unreadable" },
                "detector_a/image_raw: 1 of 6" },
        Defect{ "otherSize",
                [](Good& g)
                {
                  for (auto& image : g.images[0])
                  {
                    image.message.height = kEdge / 2;
                    image.message.data.resize(image.message.data.size() / 2);
                  }
                },
                { "image_size" },
                "256 x 128 px, not 256 x 256" },
        Defect{ "frozen",
                [](Good& g) { g.pixels(0, 1).copyTo(g.pixels(0, 2)); },
                { "image_frozen" },
                "bit for bit that of 0.2 s before" },
        Defect{ "constant", [](Good& g) { g.pixels(0, 2).setTo(20000); }, { "image_nothing" }, "1 of 6" },
        Defect{
            "black", [](Good& g) { g.pixels(1, 0).setTo(90); }, { "image_nothing" }, "detector_b/image_raw: 1 of 6" },
        Defect{ "saturated",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    cv::Mat image = g.pixels(0, k);
                    double most = 0.0;
                    cv::minMaxLoc(image(cv::Rect(100, 100, 56, 56)), nullptr, &most);
                    image *= 65535.0 / (0.6 * most);
                  }
                },
                { "image_saturated" },
                "saturated by too much light" },
        Defect{ "deadRows",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    g.pixels(0, k).rowRange(120, 122).setTo(0);
                  }
                },
                { "image_dead_lines" },
                "row 120, 121" },
        Defect{ "deadColumn",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    g.pixels(1, k).col(77).setTo(0);
                  }
                },
                { "image_dead_lines" },
                "column 77" },
        Defect{ "collimated",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    g.pixels(0, k).colRange(0, 120).setTo(130);
                  }
                },
                { "image_collimated" },
                "of what is seen of the target outside the field" },
        Defect{ "wovenRows",
                [](Good& g)
                {
                  for (int k = 0; k < kExposures; ++k)
                  {
                    cv::Mat image = g.pixels(0, k);
                    const cv::Mat before = image.clone();
                    for (int y = 1; y < kEdge; y += 2)
                    {
                      before(cv::Rect(0, y, kEdge - 6, 1)).copyTo(image(cv::Rect(6, y, kEdge - 6, 1)));
                    }
                  }
                },
                { "image_mixed_rows" },
                "detector_a/image_raw" },
        Defect{ "targetElsewhere",
                [](Good& g) { g.setup.room_from_patient.pretranslate(Eigen::Vector3d(0.0, 300.0, 0.0)); },
                { "target_outside_image", "initial_pose_off_gold_standard" },
                "300.0 mm and 0.0 degrees from the first pose" },
        Defect{ "invertedPose",
                [](Good& g) { g.setup.room_from_patient = g.setup.room_from_patient.inverse(); },
                { "target_outside_image", "initial_pose_off_gold_standard" },
                "the inverse of it (it maps room to patient) would fit" },
        Defect{ "badGoldStandard",
                [](Good& g) { g.truth[2].message.pose.orientation.w = 3.0; },
                { "gold_standard_invalid", "gold_standard_incomplete" },
                "patient_ground_truth" }),
    [](const testing::TestParamInfo<Defect>& test) { return test.param.name; });

/// With its CT, and the setup in the bag: nothing. And each way in which an initial pose may be misunderstood.
TEST(CheckBag, ComparesTheInitialPoseWithTheImages)
{
  const TemporaryFolder folder;
  writeCt(folder.file("ct.nrrd"));
  Good made = good();
  made.truth.clear();  // by which it would be seen as well
  made.setup.ct_path = folder.file("ct.nrrd");
  saveTreatmentSetup(made.setup, folder.file("setup.yaml"));
  made.more = [&](rosbag::Bag& bag)
  {
    std_msgs::String text;
    text.data = textOf(describeRun(folder.file("setup.yaml")));
    bag.write("/room/run_description", ros::Time(99, 0), text);
  };
  made.write(folder.file("x.bag"));
  EXPECT_EQ("", linesOf(checkBag(folder.file("x.bag"), "")));

  const RigidTransform right = made.setup.room_from_patient;
  const auto expectFit = [&](const TreatmentSetup& setup, const std::string& words)
  {
    saveTreatmentSetup(setup, folder.file("setup.yaml"));
    const std::vector<Finding> findings = checkBag(folder.file("x.bag"), folder.file("setup.yaml"));
    EXPECT_EQ(1u, codesOf(findings).count("initial_pose_wrong")) << linesOf(findings);
    EXPECT_NE(std::string::npos, linesOf(findings).find(words)) << linesOf(findings);
  };
  TreatmentSetup setup = made.setup;
  setup.room_from_patient = right.inverse();
  expectFit(setup, "the inverse of it (it maps room to patient) fits");
  setup.room_from_patient = right;
  setup.room_from_patient.translation() *= 0.001;
  expectFit(setup, "it in metres (translation_mm times 1000) fits");
  setup.room_from_patient = right;
  std::swap(setup.detectors[0], setup.detectors[1]);
  const auto renamed = [](const ProjectionGeometry& detector, const char* name)
  {
    DetectorDescription description = detector.description();
    description.name = name;
    return ProjectionGeometry::fromDescription(description);
  };
  setup.detectors[0] = renamed(setup.detectors[0], kNames[0]);
  setup.detectors[1] = renamed(setup.detectors[1], kNames[1]);
  expectFit(setup, "it with the two detectors' images swapped fits");

  // The CT, too, has to be the one of the recording; and hold the target.
  CtVolume other = readCtVolume(folder.file("ct.nrrd"));
  other.hu[0] ^= 1;
  writeCtVolume(other, folder.file("ct.nrrd"));
  EXPECT_EQ(std::set<std::string>{ "ct_changed" }, codesOf(checkBag(folder.file("x.bag"), "")));
  writeCt(folder.file("ct.nrrd"));
  const auto checked = [&]
  {
    saveTreatmentSetup(setup, folder.file("setup.yaml"));
    return checkBag(folder.file("x.bag"), folder.file("setup.yaml"));
  };
  setup = made.setup;
  setup.target_box.translate(Eigen::Vector3d(0.0, 0.0, 500.0));
  setup.room_from_patient = right * Eigen::Translation3d(0.0, 0.0, -500.0);
  EXPECT_EQ(1u, codesOf(checked()).count("target_outside_ct")) << linesOf(checked());
  setup = made.setup;
  setup.target_box = Eigen::AlignedBox3d(Eigen::Vector3d(30.0, 215.0, -558.0), Eigen::Vector3d(36.0, 221.0, -552.0));
  EXPECT_EQ(1u, codesOf(checked()).count("target_without_bone")) << linesOf(checked());

  // What no other reading explains: found from afar, not found; and no exposure to judge it by.
  setup = made.setup;
  setup.room_from_patient.pretranslate(Eigen::Vector3d(12.0, 0.0, 6.0));
  EXPECT_EQ(std::set<std::string>{ "initial_pose_far" }, codesOf(checked())) << linesOf(checked());
  setup.room_from_patient = right;
  setup.room_from_patient.pretranslate(Eigen::Vector3d(0.0, 30.0, 30.0));
  EXPECT_EQ(std::set<std::string>{ "initial_pose_doubtful" }, codesOf(checked())) << linesOf(checked());
  Good dark = made;
  for (int k = 0; k < kExposures; ++k)
  {
    dark.pixels(0, k).setTo(90);
  }
  dark.write(folder.file("x.bag"));
  setup = made.setup;
  EXPECT_EQ((std::set<std::string>{ "image_nothing", "initial_pose_unchecked" }), codesOf(checked()))
      << linesOf(checked());

  setup.ct_path = "/nowhere/ct.nrrd";
  EXPECT_EQ(1u, codesOf(checked()).count("ct_unreadable"));
}

TEST(CheckBag, NeedsNoSetupAndSurvivesAnyFile)
{
  const TemporaryFolder folder;
  good().write(folder.file("x.bag"));
  EXPECT_EQ(std::set<std::string>{ "setup_missing" }, codesOf(checkBag(folder.file("x.bag"), "")));
  folder.write("y.bag", "no bag at all");
  folder.write("setup.yaml", "detectors: 3\n");
  for (const auto& [bag, setup] :
       { std::pair<const char*, const char*>{ "y.bag", "" }, { "z.bag", "" }, { "x.bag", "setup.yaml" } })
  {
    const auto findings = checkBag(folder.file(bag), *setup == 0 ? "" : folder.file(setup));
    EXPECT_EQ(std::set<std::string>{ "recording_unreadable" }, codesOf(findings)) << linesOf(findings);
  }
  rosbag::Bag(folder.file("empty.bag"), rosbag::bagmode::Write).close();
  EXPECT_EQ(1u, codesOf(checkBag(folder.file("empty.bag"), "")).count("topic_missing"));
}

TEST(CheckCommands, SayItByLineJsonAndExitStatus)
{
  const TemporaryFolder folder;
  Good spoilt = good();
  spoilt.write(folder.file("x.bag"));
  const auto run = [](const std::string& command) { return runShell(std::string(COMMAND_DIR) + "/" + command); };
  const CommandResult warned = run("check_bag " + folder.file("x.bag"));
  EXPECT_EQ(1, warned.status) << warned.output;
  EXPECT_EQ(0u, warned.output.find("warning setup_missing: ")) << warned.output;
  spoilt.images[1].clear();
  spoilt.write(folder.file("x.bag"));
  saveTreatmentSetup(spoilt.setup, folder.file("setup.yaml"));
  const CommandResult failed =
      run("check_bag " + folder.file("x.bag") + " --json --setup " + folder.file("setup.yaml"));
  EXPECT_EQ(2, failed.status) << failed.output;
  const nlohmann::json json = nlohmann::json::parse(failed.output);
  EXPECT_EQ("errors", json["status"]);
  EXPECT_EQ("topic_missing", json["findings"][0]["code"]);
  EXPECT_EQ("error", json["findings"][0]["severity"]);
  EXPECT_EQ(2, run("check_bag").status);
  EXPECT_EQ(2, run("check_sequence " + folder.file("nowhere")).status);
}

/// All of a folder's defects, not the first one alone.
TEST(CheckSequence, FindsWhatLoadingRefusesAndMore)
{
  const TemporaryFolder folder;
  saveTreatmentSetup(good().setup, folder.file("sequence.yaml"));
  std::ofstream(folder.file("sequence.yaml"), std::ios::app) << "frames: frames.csv\ngold_standard: gold.csv\n";
  folder.write("gold.csv", "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n0,nan,0,0,0,0,0,1\n");
  std::string frames = "stamp_s,detector,file\n";
  Good made = good();
  for (int k = 0; k < kExposures; ++k)
  {
    for (int d = 0; d < 2; ++d)
    {
      const std::string name = std::string("ab").substr(static_cast<std::size_t>(d), 1) + std::to_string(k) + ".png";
      cv::imwrite(folder.file(name), k == 1 ? cv::Mat(kEdge, kEdge, CV_8UC3, cv::Scalar(1, 2, 3)) : made.pixels(d, k));
      frames += k == 3 && d == 1 ? "" : "0." + std::to_string(2 * k % 10) + "," + kNames[d] + "," + name + "\n";
    }
  }
  folder.write("frames.csv", frames + "2,detector_c,a0.png\n");
  std::filesystem::remove(folder.file("a4.png"));
  const std::vector<Finding> findings = checkSequence(folder.file(""));
  EXPECT_EQ((std::set<std::string>{ "ct_missing", "detector_unknown", "gold_standard_invalid", "image_missing",
                                    "image_unreadable", "time_backward" }),
            codesOf(findings))
      << linesOf(findings);
}

/// Foreign physics: scatter, blur, gain drift. Real data has true findings (docs/playback.md).
TEST(CheckSequence, FindsNothingInAGoodOne)
{
  const char* shared = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (shared == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  EXPECT_EQ("", linesOf(checkSequence(std::string(shared) + "/sequences/thorax_01")));
}
}  // namespace
}  // namespace xray_tracking
