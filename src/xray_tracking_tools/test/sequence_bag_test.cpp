#include "xray_tracking_tools/sequence_bag.h"

#include <cstdlib>

#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "test_helpers.h"

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
