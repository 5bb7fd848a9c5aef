#include "xray_tracking_tools/sequence_bag.h"

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>

#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "test_helpers.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_tools/bag_sequence.h"

namespace xray_tracking
{
namespace
{
void noProgress(std::size_t, std::size_t) {}

template <typename Message>
std::vector<typename Message::ConstPtr> readTopic(const std::string& path, const std::string& topic)
{
  const rosbag::Bag bag(path);
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  std::vector<typename Message::ConstPtr> messages;
  for (const rosbag::MessageInstance& instance : view)
  {
    const auto message = instance.instantiate<Message>();
    EXPECT_TRUE(message) << topic << " is " << instance.getDataType();
    // A player goes by the bag's times, everybody else by the stamps.
    EXPECT_EQ(instance.getTime(), message->header.stamp) << topic;
    messages.push_back(message);
  }
  return messages;
}

int pixel(const sensor_msgs::Image& image, int row, int column)
{
  const std::size_t at = static_cast<std::size_t>(row) * image.step + 2 * column;
  return image.data[at] + 256 * image.data[at + 1];
}

TEST(SequenceBag, keepsEveryPixelAndStamp)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  std::vector<std::size_t> done;
  writeSequenceBag(loadSequence(folder.file("")), folder.file("out.bag"),
                   [&done](std::size_t k, std::size_t total)
                   {
                     EXPECT_EQ(5U, total);
                     done.push_back(k);
                   });
  EXPECT_EQ((std::vector<std::size_t>{ 1, 2, 3, 4, 5 }), done);
  EXPECT_FALSE(std::filesystem::exists(folder.file("out.bag.partial")));

  for (int d = 0; d < 2; ++d)
  {
    const std::string detector = std::string("detector_") + "ab"[d];
    const auto images = readTopic<sensor_msgs::Image>(folder.file("out.bag"), "/" + detector + "/image_raw");
    ASSERT_EQ(5U, images.size());
    for (int k = 0; k < 5; ++k)
    {
      const sensor_msgs::Image& image = *images[k];
      EXPECT_EQ(ros::Time(1000 + k / 4, 250000000 * (k % 4)), image.header.stamp);
      EXPECT_EQ(detector + "_optical_frame", image.header.frame_id);
      EXPECT_EQ("mono16", image.encoding);
      EXPECT_EQ(0, image.is_bigendian);
      EXPECT_EQ(2U * kColumns, image.step);
      ASSERT_EQ(2U * kColumns * kRows, image.data.size());
      for (int row = 0; row < kRows; ++row)
      {
        for (int column = 0; column < kColumns; ++column)
        {
          ASSERT_EQ(testValue(k, d, row, column), pixel(image, row, column)) << k << " " << row << " " << column;
        }
      }
    }
  }
}

TEST(SequenceBag, carriesGeometryAndGoldStandard)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  writeSequenceBag(loadSequence(folder.file("")), folder.file("out.bag"), noProgress);

  const auto infos = readTopic<sensor_msgs::CameraInfo>(folder.file("out.bag"), "/detector_a/camera_info");
  ASSERT_EQ(5U, infos.size());
  EXPECT_EQ(ros::Time(1000, 250000000), infos[1]->header.stamp);
  EXPECT_EQ("detector_a_optical_frame", infos[1]->header.frame_id);
  EXPECT_NEAR(1000.0 / 0.5, infos[1]->K[0], 1e-6);
  EXPECT_NEAR(1000.0 / 0.25, infos[1]->K[4], 1e-6);
  EXPECT_NEAR(3.0, infos[1]->K[2], 1e-9);
  EXPECT_NEAR(2.0, infos[1]->K[5], 1e-9);

  const auto truth = readTopic<geometry_msgs::PoseStamped>(folder.file("out.bag"), "/patient_ground_truth");
  ASSERT_EQ(5U, truth.size());
  EXPECT_EQ("treatment_room", truth[3]->header.frame_id);
  EXPECT_NEAR(0.013, truth[3]->pose.position.x, 1e-12);
  EXPECT_NEAR(0.030, truth[3]->pose.position.z, 1e-12);
  EXPECT_NEAR(1.0, truth[3]->pose.orientation.w, 1e-12);
}

TEST(SequenceBag, keepsEightBitValues)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const cv::Mat image(kRows, kColumns, CV_8UC1, cv::Scalar(201));
  cv::imwrite(folder.file("image_b2.png"), image);
  writeSequenceBag(loadSequence(folder.file("")), folder.file("out.bag"), noProgress);
  const auto images = readTopic<sensor_msgs::Image>(folder.file("out.bag"), "/detector_b/image_raw");
  ASSERT_EQ(5U, images.size());
  EXPECT_EQ("mono16", images[2]->encoding);
  EXPECT_EQ(201, pixel(*images[2], 3, 4));
}

TEST(SequenceBag, takesTheFirstExposures)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  Sequence sequence = loadSequence(folder.file(""));
  EXPECT_THROW(keepFirstExposures(sequence, 0), std::invalid_argument);
  EXPECT_THROW(keepFirstExposures(sequence, 6), std::invalid_argument);
  keepFirstExposures(sequence, 2);
  writeSequenceBag(sequence, folder.file("out.bag"), noProgress);
  EXPECT_EQ(2U, readTopic<sensor_msgs::Image>(folder.file("out.bag"), "/detector_a/image_raw").size());
  EXPECT_EQ(2U, readTopic<geometry_msgs::PoseStamped>(folder.file("out.bag"), "/patient_ground_truth").size());
}

/// Numbers with all their digits, stamps to the nanosecond, values of 8 and of 16 bit.
void writeAwkwardSequence(const TemporaryFolder& folder)
{
  writeTestSequence(folder);
  folder.write("detectors.yaml", R"(detectors:
  - {name: detector_a, image_size: [8, 6], pixel_pitch_mm: [0.50000000000000011, 0.1], source_mm: [0.1, 1e-17, 600.3],
     origin_mm: [-1.5, 0.5, -400.00000000000006], x_direction: [0.8, 0.6, 0], y_direction: [0.6, -0.8, 0]}
  - {name: detector_b, image_size: [8, 6], pixel_pitch_mm: [0.5, 0.25], source_mm: [0, 600, 0],
     origin_mm: [-1.5, -400, -0.5], x_direction: [1, 0, 0], y_direction: [0, 0, 1]}
)");
  folder.write("sequence.yaml", R"(# a comment
ct: "a ct.nrrd"
intensity: {kind: counts, offset: 0.1}
detectors: detectors.yaml
frames: frames.csv
gold_standard: gold_standard.csv
initial_pose: {translation_mm: [0.1, 220.33333333333334, 3.0000000000000004],
  rotation_xyzw: [0.18257418583505536, 0.36514837167011072, 0.54772255750516607, 0.73029674334022143]}
target_box_mm: {min: [-12, -21, -31], max: [-8, -19.000000000000004, -29]}
regions: {detector_a: {x_offset: 1, y_offset: 2, width: 3, height: 4}}
)");
  cv::imwrite(folder.file("image_a0.png"), cv::Mat(kRows, kColumns, CV_8UC1, cv::Scalar(201)));
  std::string frames = "stamp_s,detector,file\n", gold = "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
  for (int k = 0; k < 5; ++k)
  {
    const std::string stamp = std::to_string(k) + ".12345678" + std::to_string(k);
    frames += stamp + ",detector_a,image_a" + std::to_string(k) + ".png\n" + stamp + ",detector_b,image_b" +
              std::to_string(k) + ".png\n";
    gold += stamp + ",0.1,1.0000000000000002,-553.70000000000005,0.5,-0.5,0.50000000000000011,-0.49999999999999994\n" +
            std::to_string(k) + ".9,1,2,3,0,0,0,1\n";
  }
  folder.write("frames.csv", frames);
  folder.write("gold_standard.csv", gold);
}

std::string contents(const std::string& path)
{
  std::ifstream file(path, std::ios::binary);
  return { std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>() };
}

/// To the last bit.
void expectSame(const Sequence& a, const Sequence& b)
{
  const auto same_pose = [](const RigidTransform& x, const RigidTransform& y)
  { return std::memcmp(x.data(), y.data(), sizeof(double) * 16) == 0; };
  EXPECT_TRUE(same_pose(a.setup.room_from_patient, b.setup.room_from_patient));
  EXPECT_EQ(a.setup.ct_path, b.setup.ct_path);
  EXPECT_EQ(a.setup.intensity.offset, b.setup.intensity.offset);
  EXPECT_EQ(a.setup.target_box.min(), b.setup.target_box.min());
  EXPECT_EQ(a.setup.target_box.max(), b.setup.target_box.max());
  EXPECT_EQ(a.setup.regions, b.setup.regions);
  ASSERT_EQ(a.setup.detectors.size(), b.setup.detectors.size());
  for (std::size_t d = 0; d < a.setup.detectors.size(); ++d)
  {
    const DetectorDescription& x = a.setup.detectors[d].description();
    const DetectorDescription& y = b.setup.detectors[d].description();
    EXPECT_EQ(x.name, y.name);
    EXPECT_EQ(x.image_size, y.image_size);
    EXPECT_EQ(x.pixel_pitch, y.pixel_pitch);
    EXPECT_EQ(x.source, y.source);
    EXPECT_EQ(x.origin, y.origin);
    EXPECT_EQ(x.x_direction, y.x_direction);
    EXPECT_EQ(x.y_direction, y.y_direction);
  }
  ASSERT_EQ(a.exposures.size(), b.exposures.size());
  ASSERT_EQ(a.gold_standard.size(), b.gold_standard.size());
  for (std::size_t k = 0; k < a.exposures.size(); ++k)
  {
    EXPECT_EQ(a.exposures[k].stamp_ns, b.exposures[k].stamp_ns);
    EXPECT_TRUE(same_pose(a.gold_standard[k].room_from_patient, b.gold_standard[k].room_from_patient)) << k;
    for (std::size_t d = 0; d < a.setup.detectors.size(); ++d)
    {
      const auto read = [&](const Sequence& sequence) { return sequence.image(k, d); };
      EXPECT_EQ(0, cv::norm(read(a), read(b), cv::NORM_INF));
    }
  }
}

TEST(BagSequence, LosesNothingThereAndBack)
{
  const TemporaryFolder folder;
  writeAwkwardSequence(folder);
  const Sequence sequence = loadSequence(folder.file(""));
  writeSequenceBag(sequence, folder.file("a.bag"), noProgress);
  const auto run = [](const std::string& command) { return runShell(std::string(COMMAND_DIR) + "/" + command); };
  const CommandResult result = run("bag_to_sequence " + folder.file("a.bag") + " " + folder.file("back"));
  EXPECT_EQ(0, result.status) << result.output;
  EXPECT_NE(std::string::npos, result.output.find("5 exposures, with gold standard")) << result.output;
  expectSame(sequence, loadSequence(folder.file("back")));
  EXPECT_EQ(contents(folder.file("gold_standard.csv")), contents(folder.file("back/gold_standard.csv")));
  // Nothing is overwritten.
  const CommandResult again = run("bag_to_sequence " + folder.file("a.bag") + " " + folder.file("back"));
  EXPECT_EQ(1, again.status);
  EXPECT_NE(std::string::npos, again.output.find("is there already")) << again.output;
  // And the bag again.
  writeSequenceBag(loadSequence(folder.file("back")), folder.file("b.bag"), noProgress);
  for (const char* topic : { "/detector_a/image_raw", "/detector_b/image_raw" })
  {
    const auto a = readTopic<sensor_msgs::Image>(folder.file("a.bag"), topic);
    const auto b = readTopic<sensor_msgs::Image>(folder.file("b.bag"), topic);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t k = 0; k < a.size(); ++k)
    {
      EXPECT_EQ(a[k]->data, b[k]->data);
      EXPECT_EQ(a[k]->header.stamp, b[k]->header.stamp);
    }
  }
}

/// A recording in two parts, of a driver with 8 bit and of another one's topics, an exposure of which lacks a view.
TEST(BagSequence, TakesWhatIsComplete)
{
  const TemporaryFolder folder;
  writeAwkwardSequence(folder);
  for (int part = 0; part < 2; ++part)
  {
    rosbag::Bag bag(folder.file("r_" + std::to_string(part) + ".bag"), rosbag::bagmode::Write);
    for (int k = 2 * part; k < 2 * part + 2; ++k)
    {
      const ros::Time stamp(1600000000 + k, 7);
      for (int d = 0; d < (k == 1 ? 1 : 2); ++d)
      {
        sensor_msgs::Image image;
        image.header.stamp = stamp;
        image.encoding = "mono8";
        image.width = image.step = kColumns;
        image.height = kRows;
        image.data.assign(kColumns * kRows, static_cast<std::uint8_t>(10 * k + d));
        bag.write(std::string("/room/detector_") + "ab"[d] + "/image_raw", stamp, image);
      }
      geometry_msgs::PoseStamped truth;
      truth.header.stamp = stamp;
      truth.pose.position.x = 0.1 + 1e-3 / 3.0 * k;
      truth.pose.orientation.w = 1.0;
      bag.write("/room/patient_ground_truth", stamp, truth);
    }
    bag.close();
  }
  const Recording recording(folder.file("r_0.bag"));
  EXPECT_EQ(2u, recording.files().size());
  EXPECT_THROW(writeSequenceFolder(recording, "", folder.file("none")), std::runtime_error);
  EXPECT_FALSE(std::filesystem::exists(folder.file("none")));
  const ExtractedSequence extracted =
      writeSequenceFolder(recording, folder.file("sequence.yaml"), folder.file("sequence"));
  EXPECT_EQ(3u, extracted.exposures);
  EXPECT_EQ(1u, extracted.incomplete);
  const Sequence sequence = loadSequence(folder.file("sequence"));
  ASSERT_EQ(3u, sequence.exposures.size());
  EXPECT_EQ(1600000002000000007, sequence.exposures[1].stamp_ns);
  EXPECT_EQ(21, sequence.image(1, 1).at<std::uint16_t>(3, 3));
  EXPECT_DOUBLE_EQ(100.0 + 2.0 / 3.0, sequence.gold_standard[1].room_from_patient.translation().x());
  EXPECT_EQ(6, std::distance(std::filesystem::directory_iterator(folder.file("sequence")), {}) - 3);
  // A folder's name may end as folders' names do.
  EXPECT_EQ(3u, writeSequenceFolder(recording, folder.file("sequence.yaml"), folder.file("another/")).exposures);
  EXPECT_EQ(3u, loadSequence(folder.file("another/")).exposures.size());
}

/// What says that the images are of another geometry than the setup's, or of none, is not read as the setup's.
TEST(BagSequence, GoesByWhatCameraInfosSay)
{
  const TemporaryFolder folder;
  writeAwkwardSequence(folder);
  const Sequence sequence = loadSequence(folder.file(""));
  const sensor_msgs::CameraInfo good = cameraInfoFromGeometry(sequence.setup.detectors[1]);
  struct Case
  {
    std::function<void(sensor_msgs::CameraInfo&)> change;
    const char* said;  ///< empty: it is taken
  };
  using Info = sensor_msgs::CameraInfo;
  const Case cases[] = {
    { [](Info&) {}, "" },
    { [](Info& info) { info.P.fill(0.0); }, "" },  // as drivers of one camera leave it
    { [](Info& info) { info.K.fill(0.0); }, "K[0] is 0" },
    { [](Info& info) { info.K.fill(std::nan("")); }, "K[0] is nan" },
    { [](Info& info) { info.K[0] *= 2.0; }, "P[0]" },
    { [](Info& info) { info.K[0] *= 2.0, info.P.fill(0.0); }, "fx is " },
    { [](Info& info) { info.K[5] += 1.0, info.P.fill(0.0); }, "cy is " },
    { [](Info& info) { info.K[1] = 5.0; }, "K[1] is 5" },
    { [](Info& info) {
       info.D = { 0.1, 0.0, 0.0, 0.0, 0.0 };
     },
      "D[0] is 0.1" },
    { [](Info& info) { info.R[0] = -1.0; }, "R[0] is -1" },
    { [](Info& info) { info.binning_x = 2; }, "binning_x is 2" },
    { [](Info& info) { info.roi.x_offset = 1; }, "roi is " },
    { [](Info& info) { ++info.width; }, "size is " },
  };
  for (const Case& each : cases)
  {
    sensor_msgs::CameraInfo info = good;
    each.change(info);
    const std::string difference = cameraInfoDifference(info, sequence.setup.detectors[1]);
    EXPECT_EQ(*each.said == '\0', difference.empty()) << each.said << ": " << difference;
    EXPECT_NE(std::string::npos, difference.find(each.said)) << difference;
  }

  writeSequenceBag(sequence, folder.file("a.bag"), noProgress);
  {
    rosbag::Bag bag(folder.file("a.bag"), rosbag::bagmode::Append);
    sensor_msgs::CameraInfo distorted = good;
    distorted.D = { 0.1, 0.0, 0.0, 0.0, 0.0 };
    distorted.header.stamp = ros::Time(1000);
    bag.write("/detector_b/camera_info", ros::Time(1000), distorted);
  }
  for (const std::string& command :
       { "bag_to_sequence " + folder.file("a.bag") + " ",
         "evaluate_sequence --methods tracking --bag " + folder.file("a.bag") + " --out " })
  {
    const CommandResult result = runShell(std::string(COMMAND_DIR) + "/" + command + folder.file("out"));
    EXPECT_EQ(1, result.status);
    EXPECT_NE(std::string::npos, result.output.find("D[0] is 0.1")) << result.output;
    EXPECT_FALSE(std::filesystem::exists(folder.file("out")));
  }
}

TEST(SequenceBag, refusesStampsThatRosTimeCannotHold)
{
  EXPECT_EQ(ros::Time(1001, 5), playbackTime(1000000005));
  EXPECT_EQ(ros::Time(4294967295U, 0), playbackTime(4294966295LL * 1000000000));
  EXPECT_THROW(playbackTime(4294966295LL * 1000000000 + 1), std::invalid_argument);
  EXPECT_THROW(playbackTime(-kPlaybackEpochNs), std::invalid_argument);  // would be 0, "no time"
}

TEST(SequenceBag, convertsTheThoraxSequence)
{
  const char* shared_data = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (shared_data == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  const std::string source = std::string(shared_data) + "/sequences/thorax_01/";
  const TemporaryFolder folder;
  writeSequenceBag(loadSequence(source), folder.file("thorax.bag"), noProgress);
  for (const std::string detector : { "detector_a", "detector_b" })
  {
    const auto images = readTopic<sensor_msgs::Image>(folder.file("thorax.bag"), "/" + detector + "/image_raw");
    ASSERT_EQ(20U, images.size());
    for (int k = 0; k < 20; ++k)
    {
      char name[40];
      std::snprintf(name, sizeof(name), "%s_%03d.png", detector.c_str(), k);
      const cv::Mat file = cv::imread(source + name, cv::IMREAD_UNCHANGED);
      ASSERT_EQ(CV_16UC1, file.type()) << name;
      ASSERT_EQ(file.total() * 2, images[k]->data.size()) << name;
      EXPECT_EQ(0, std::memcmp(file.data, images[k]->data.data(), images[k]->data.size())) << name;
      EXPECT_EQ(ros::Time(1000 + k / 2, 500000000 * (k % 2)), images[k]->header.stamp);
    }
  }
  EXPECT_EQ(20U, readTopic<geometry_msgs::PoseStamped>(folder.file("thorax.bag"), "/patient_ground_truth").size());
}
}  // namespace
}  // namespace xray_tracking
