#include "xray_tracking_tools/tracking_record.h"

#include <limits>

#include <gtest/gtest.h>

#include "recorded_run.h"
#include "test_helpers.h"
#include "xray_tracking_tools/sequence_bag.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;

const Eigen::AlignedBox3d kBox(Eigen::Vector3d(-10, -10, -10), Eigen::Vector3d(10, 10, 10));

std::string errorOf(const std::function<void()>& call)
{
  try
  {
    call();
  }
  catch (const std::runtime_error& e)
  {
    return e.what();
  }
  return "no error";
}

testing::AssertionResult contains(const std::string& text, const std::string& part)
{
  return text.find(part) != std::string::npos
             ? testing::AssertionSuccess()
             : testing::AssertionFailure() << "'" << text << "' lacks '" << part << "'";
}

TEST(TrackingRecord, judgesALiveRun)
{
  const TemporaryFolder folder;
  writeTestRun(folder.file("run.bag"));
  const TrackingRecord record = readTrackingRecord(folder.file("run.bag"), 0);
  const Evaluation evaluation = evaluateRecord(record, "phantom", kBox);
  ASSERT_EQ(6U, evaluation.stamps_ns.size());
  EXPECT_EQ(52000000000, evaluation.stamps_ns[2]);
  ASSERT_EQ(1U, evaluation.methods.size());
  EXPECT_EQ("tracking", evaluation.methods[0].method);
  const std::vector<FrameResult>& frames = evaluation.methods[0].frames;
  ASSERT_EQ(6U, frames.size());
  EXPECT_EQ(FrameStatus::OK, frames[0].status);
  EXPECT_EQ(FrameStatus::LOST, frames[3].status);
  EXPECT_EQ(FrameStatus::FAILED, frames[4].status);
  EXPECT_EQ(FrameStatus::LOST, frames[5].status);
  EXPECT_NEAR(0.002, frames[1].cpu_s, 1e-12);
  EXPECT_NEAR(0.003, frames[1].wall_s, 1e-12);

  // Without rotation the TRE is the length of the translation's error.
  const std::vector<MethodSummary> summaries = summarize(evaluation);
  ASSERT_EQ(2U, summaries.size());
  EXPECT_EQ("uncorrected", summaries[0].method);
  ASSERT_EQ(5U, summaries[0].tre_mm.size());
  EXPECT_NEAR(4.0, summaries[0].tre_mm[3], 1e-9);
  ASSERT_EQ(2U, summaries[1].tre_mm.size());
  EXPECT_NEAR(0.5, summaries[1].tre_mm[0], 1e-9);
  EXPECT_NEAR(2.0, summaries[1].tre_mm[1], 1e-9);
  EXPECT_EQ(2, summaries[1].lost);
  EXPECT_EQ(1, summaries[1].failed);
  EXPECT_NEAR(1.0 / 5.0, summaries[1].within_1_2_mm, 1e-12);
  EXPECT_NEAR(2.0 / 5.0, summaries[1].within_2_4_mm, 1e-12);

  const std::vector<std::string> unanswered = unansweredExposures(evaluation, record);
  ASSERT_EQ(3U, unanswered.size());
  EXPECT_EQ("frame 3 (53.0000 s) of tracking lost: detector_b lost its region", unanswered[0]);
  EXPECT_EQ("frame 4 (54.0000 s) of tracking failed: no patient_motion", unanswered[1]);
  EXPECT_EQ("frame 5 (55.0000 s) of tracking lost: the views disagree by 9 px", unanswered[2]);
}

TEST(TrackingRecord, judgesWithoutGoldStandard)
{
  const TemporaryFolder folder;
  RecordedRun run(folder.file("run.bag"));
  run.answer(ros::Time(7, 0), 1, 2, 3);
  run.exposure(ros::Time(8, 0));  // seen by the detector, answered by nobody
  run.motion(ros::Time(9, 0), PatientMotion::OK);
  run.close();
  const TrackingRecord record = readTrackingRecord(folder.file("run.bag"), 0);
  const Evaluation evaluation = evaluateRecord(record, "live", kBox);
  EXPECT_TRUE(evaluation.gold_standard.empty());
  const std::vector<FrameResult>& frames = evaluation.methods[0].frames;
  ASSERT_EQ(3U, frames.size());
  EXPECT_LT((frames[0].room_from_patient.translation() - Eigen::Vector3d(1, 2, 3)).norm(), 1e-9);
  EXPECT_EQ(FrameStatus::FAILED, frames[1].status);
  EXPECT_EQ(FrameStatus::FAILED, frames[2].status);
  EXPECT_EQ("frame 2 (9.0000 s) of tracking failed: patient_motion without patient_pose",
            unansweredExposures(evaluation, record).at(1));
}

TEST(TrackingRecord, judgesRefinedPosesBesideThePublishedOnes)
{
  using xray_tracking_msgs::RefinementResult;
  const TemporaryFolder folder;
  RecordedRun run(folder.file("run.bag"), "tracking_and_registration");
  for (int k = 0; k < 4; ++k)
  {
    run.truth(ros::Time(50 + k, 0), 0, 0, 0);
    run.answer(ros::Time(50 + k, 0), 0, 3, 0);
  }
  run.refined(ros::Time(50, 0), RefinementResult::SUCCESS, 0, 0, 0);
  run.refined(ros::Time(51, 0), RefinementResult::NO_EXPOSURE, 0, 0, 0);  // it had not come yet
  run.refined(ros::Time(51, 0), RefinementResult::SUCCESS, 0.25, 0, 0);
  run.refined(ros::Time(52, 0), RefinementResult::UNRELIABLE, 9, 9, 9);
  run.close();
  const TrackingRecord record = readTrackingRecord(folder.file("run.bag"), 0);
  const Evaluation evaluation = evaluateRecord(record, "phantom", kBox);
  ASSERT_EQ(2U, evaluation.methods.size());
  EXPECT_EQ("tracking_and_registration", evaluation.methods[0].method);
  EXPECT_EQ("registration", evaluation.methods[1].method);
  const std::vector<FrameResult>& published = evaluation.methods[0].frames;
  const std::vector<FrameResult>& frames = evaluation.methods[1].frames;
  ASSERT_EQ(4U, frames.size());
  EXPECT_EQ(FrameStatus::OK, frames[1].status);
  EXPECT_EQ(FrameStatus::LOST, frames[2].status);
  EXPECT_EQ(FrameStatus::FAILED, frames[3].status);
  // What was published has cost the registration too, and waited for it.
  EXPECT_NEAR(0.032, published[2].cpu_s, 1e-12);
  EXPECT_NEAR(0.002, published[3].cpu_s, 1e-12);
  EXPECT_NEAR(0.003, published[2].wall_s, 1e-12);
  EXPECT_NEAR(0.03, frames[2].cpu_s, 1e-12);
  EXPECT_NEAR(0.02, frames[2].wall_s, 1e-12);
  const std::vector<MethodSummary> summaries = summarize(evaluation);
  ASSERT_EQ(3U, summaries.size());
  EXPECT_EQ(3U, summaries[1].tre_mm.size());
  ASSERT_EQ(1U, summaries[2].tre_mm.size());
  EXPECT_NEAR(0.25, summaries[2].tre_mm[0], 1e-9);
  EXPECT_EQ(std::vector<std::string>({ "frame 2 (52.0000 s) of registration lost: status 1",
                                       "frame 3 (53.0000 s) of registration failed: no refined_pose" }),
            unansweredExposures(evaluation, record));
}

TEST(TrackingRecord, registeredPosesThatWerePublishedAreJudgedOnce)
{
  const TemporaryFolder folder;
  RecordedRun run(folder.file("run.bag"), "registration");
  run.answer(ros::Time(50, 0), 0, 3, 0);
  run.refined(ros::Time(50, 0), xray_tracking_msgs::RefinementResult::SUCCESS, 0, 3, 0);
  run.close();
  const Evaluation evaluation = evaluateRecord(readTrackingRecord(folder.file("run.bag"), 0), "phantom", kBox);
  ASSERT_EQ(1U, evaluation.methods.size());
  EXPECT_EQ("registration", evaluation.methods[0].method);
}

TEST(TrackingRecord, judgesAPlayedSequence)
{
  const TemporaryFolder folder;
  writeTestSequence(folder);
  const Sequence sequence = loadSequence(folder.file(""));
  RecordedRun run(folder.file("run.bag"));
  run.answer(ros::Time(1000, 0), 10, 20, 30);
  run.answer(ros::Time(1000, 250000000), 11, 20, 30.75);
  run.answer(ros::Time(1001, 0), 14, 20, 30);
  run.close();
  const Evaluation evaluation =
      evaluateRecord(readTrackingRecord(folder.file("run.bag"), kPlaybackEpochNs), "test", sequence);
  EXPECT_EQ((std::vector<std::int64_t>{ 0, 250000000, 500000000, 750000000, 1000000000 }), evaluation.stamps_ns);
  const std::vector<FrameResult>& frames = evaluation.methods[0].frames;
  ASSERT_EQ(5U, frames.size());
  EXPECT_EQ(FrameStatus::FAILED, frames[2].status);
  EXPECT_EQ(FrameStatus::FAILED, frames[3].status);
  const MethodSummary tracking = summarize(evaluation).at(1);
  ASSERT_EQ(2U, tracking.tre_mm.size());
  EXPECT_NEAR(0.75, tracking.tre_mm[0], 1e-9);
  EXPECT_NEAR(0.0, tracking.tre_mm[1], 1e-9);
}

TEST(TrackingRecord, namesWhatIsWrong)
{
  const TemporaryFolder folder;
  const std::string path = folder.file("run.bag");
  const auto errorOfRun = [&path](const std::function<void(RecordedRun&)>& write)
  {
    RecordedRun run(path);
    write(run);
    run.close();
    return errorOf([&path] { evaluateRecord(readTrackingRecord(path, 0), "test", kBox); });
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::string nan_error = errorOfRun([nan](RecordedRun& run) { run.answer(ros::Time(5, 0), 1, nan, 3); });
  EXPECT_TRUE(contains(nan_error, "run.bag: /patient_pose at 5.0000 s: "));
  EXPECT_TRUE(contains(nan_error, "nan"));
  EXPECT_TRUE(contains(errorOfRun([](RecordedRun& run) { run.motion(ros::Time(5, 0), 77); }), "state is 77"));
  EXPECT_TRUE(contains(errorOfRun(
                           [](RecordedRun& run)
                           {
                             run.motion(ros::Time(5, 0), PatientMotion::LOST);
                             run.motion(ros::Time(5, 0), PatientMotion::LOST);
                           }),
                       "/patient_motion at 5.0000 s: two messages of one exposure"));
  EXPECT_TRUE(contains(errorOfRun(
                           [](RecordedRun& run)
                           {
                             run.truth(ros::Time(5, 0), 0, 0, 0);
                             run.motion(ros::Time(6, 0), PatientMotion::LOST);
                           }),
                       "the exposure at 6.0000 s has no patient_ground_truth"));
  EXPECT_TRUE(
      contains(errorOfRun([](RecordedRun& run) { run.refined(ros::Time(5, 0), 77, 0, 0, 0); }), "status is 77"));
  EXPECT_TRUE(contains(errorOfRun([](RecordedRun&) {}), "no exposure"));
  EXPECT_TRUE(contains(errorOf([&folder] { readTrackingRecord(folder.file("none.bag"), 0); }), "none.bag"));

  writeTestSequence(folder);
  const Sequence sequence = loadSequence(folder.file(""));
  RecordedRun run(path);
  run.answer(ros::Time(1000, 123000000), 0, 0, 0);
  run.close();
  EXPECT_TRUE(contains(errorOf([&] { evaluateRecord(readTrackingRecord(path, kPlaybackEpochNs), "test", sequence); }),
                       "the bag's exposure at 0.1230 s is none of the sequence's"));
}
}  // namespace
}  // namespace xray_tracking
