#include "bag_recorder.h"

#include <csignal>

#include <QApplication>
#include <QFile>
#include <QRegularExpression>
#include <QTemporaryDir>

#include <gtest/gtest.h>

#include "spin_until.h"

namespace xray_tracking
{
namespace
{
/// All that the launch files' recorder takes: a recording has to be judged by itself.
TEST(RecordedTopics, AreThoseThatARecordingIsJudgedBy)
{
  for (const QString& room : { QString("/"), QString("/room/") })
  {
    const QRegularExpression topics(QRegularExpression::anchoredPattern(recordedTopics(room)));
    for (const char* name : { "run_description", "left/image_raw", "left/camera_info", "left/tracked_region",
                              "wall/left/image_raw", "left_hyperplane_tracker/parameter_updates", "patient_pose",
                              "patient_motion", "predicted_pose", "beam_gate", "refined_pose", "patient_ground_truth" })
    {
      EXPECT_TRUE(topics.match(room + name).hasMatch()) << name;
    }
    for (const char* name : { "/tf", "/tf_static", "/diagnostics", "/rosout" })
    {
      EXPECT_TRUE(topics.match(name).hasMatch()) << name;
    }
    EXPECT_FALSE(topics.match(room + "left/tracked_region_image").hasMatch());
  }
}

/// With a `rosrun` of its own.
class BagRecorderTest : public testing::Test
{
protected:
  void SetUp() override { path_ = qgetenv("PATH"); }
  void TearDown() override { qputenv("PATH", path_); }

  /// @param script what it does; $4 is the bag's path
  void rosrunIs(const QByteArray& script)
  {
    QFile file(folder_.filePath("rosrun"));
    ASSERT_TRUE(file.open(QIODevice::WriteOnly));
    file.write("#!/bin/sh\n" + script);
    file.close();
    ASSERT_TRUE(file.setPermissions(QFile::ReadOwner | QFile::WriteOwner | QFile::ExeOwner));
    qputenv("PATH", folder_.path().toLocal8Bit() + ":" + path_);
  }

  void start()
  {
    recorder_.start(folder_.filePath("recordings"));
    ASSERT_TRUE(spinUntil([&] { return QFile::exists(folder_.filePath("begun")); }));
  }

  QTemporaryDir folder_;
  QByteArray path_;
  BagRecorder recorder_{ "/x", nullptr };
};

TEST_F(BagRecorderTest, TellsAtOnceThatItRecordsNothingAnyMore)
{
  // As rosbag says it, in colour; it goes on without writing.
  rosrunIs(
      "touch $(dirname $0)/begun; printf '\\033[0m[ INFO] [1.5]: Subscribing to /x\\033[0m\\n'\n"
      "printf '\\033[31m[ERROR] [1700000000.25]: Less than 1G of space free on disk with /x.bag. Disabling '\n"
      "sleep 0.2; printf 'recording.\\033[0m\\n'; exec sleep 20\n");
  start();
  EXPECT_TRUE(spinUntil([&] { return recorder_.fault().contains("Disabling recording."); }, 3.0))
      << recorder_.fault().toStdString();
  EXPECT_TRUE(recorder_.recording());
  EXPECT_FALSE(recorder_.fault().contains("INFO"));
}

TEST_F(BagRecorderTest, ABagThatIsNotThereWasNotRecorded)
{
  rosrunIs("trap 'exit 0' INT; touch $(dirname $0)/begun; while true; do sleep 0.05; done\n");
  start();
  recorder_.stop();
  ASSERT_TRUE(spinUntil([&] { return !recorder_.recording(); }));
  EXPECT_TRUE(recorder_.fault().contains(recorder_.file())) << recorder_.fault().toStdString();
}

TEST_F(BagRecorderTest, ABagThatIsThereIsNoFault)
{
  rosrunIs("trap \"touch '$4'; exit 0\" INT; touch $(dirname $0)/begun; while true; do sleep 0.05; done\n");
  start();
  recorder_.stop();
  ASSERT_TRUE(spinUntil([&] { return !recorder_.recording(); }));
  EXPECT_EQ(recorder_.fault(), "");
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  std::signal(SIGINT, SIG_DFL);  // what a shell runs in the background ignores it, and whatever that starts
  const QCoreApplication application(argc, argv);
  return RUN_ALL_TESTS();
}
