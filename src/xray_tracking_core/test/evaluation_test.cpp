#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>

#include <gtest/gtest.h>
#include <boost/property_tree/json_parser.hpp>

#include "test_helpers.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const Eigen::AlignedBox3d kBox(Eigen::Vector3d(-25.0, 192.0, -585.0), Eigen::Vector3d(23.0, 248.0, -521.0));

RigidTransform shifted(const RigidTransform& pose, double x)
{
  return Eigen::Translation3d(x, 0.0, 0.0) * pose;
}

FrameResult answer(const RigidTransform& pose, double seconds)
{
  FrameResult frame;
  frame.status = FrameStatus::OK;
  frame.room_from_patient = pose;
  frame.cpu_s = seconds;
  frame.wall_s = 2.0 * seconds;
  return frame;
}

FrameResult without(FrameStatus status)
{
  FrameResult frame;
  frame.status = status;
  frame.cpu_s = 0.9;
  return frame;
}

/// Six exposures; the target moves by 0, 1, 2, .. mm. `good` is off by 0.1 mm times the frame's number, `poor` by 1 mm
/// times it, with a lost and a failed frame and one whose pose is NaN.
Evaluation exampleEvaluation()
{
  Evaluation evaluation;
  evaluation.sequence = "a \"quoted\" \\ name";
  evaluation.target_box = kBox;
  evaluation.methods = { { "good", {} }, { "poor", {} } };
  const RigidTransform start = makeRigidTransform({ 553.36, 0.7, 219.69 }, { -0.5, 0.5, -0.5, 0.5 });
  for (int i = 0; i < 6; ++i)
  {
    evaluation.stamps_ns.push_back(1700000000123456789 + 500000000LL * i);
    evaluation.gold_standard.push_back(shifted(start, i));
    evaluation.methods[0].frames.push_back(answer(shifted(start, 1.1 * i), i == 0 ? 0.4 : 0.001 * i));
    evaluation.methods[1].frames.push_back(answer(shifted(start, 2.0 * i), 0.01));
  }
  evaluation.methods[1].frames[3] = without(FrameStatus::LOST);
  evaluation.methods[1].frames[4] = without(FrameStatus::FAILED);
  evaluation.methods[1].frames[5].room_from_patient.translation().x() = kNan;
  return evaluation;
}

std::vector<std::vector<std::string>> readTable(const std::string& path)
{
  std::vector<std::vector<std::string>> rows;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);)
  {
    rows.emplace_back();
    std::istringstream fields(line + ",");  // keeps an empty last field
    for (std::string field; std::getline(fields, field, ',');)
    {
      rows.back().push_back(field);
    }
  }
  return rows;
}

TEST(TargetRegistrationError, IsTheIntegralOverTheBox)
{
  Twist twist;
  twist << 0.03, -0.05, 0.02, 1.0, -0.5, 0.25;
  const RigidTransform gold = makeRigidTransform({ 553.36, 0.7, 219.69 }, { 0.5, -0.5, 0.5, -0.5 });
  const RigidTransform estimate = gold * motionAbout(kBox.center(), twist);
  constexpr int kCells = 40;
  double sum = 0.0;
  for (int i = 0; i < kCells * kCells * kCells; ++i)
  {
    const Eigen::Array3d cell(i % kCells, i / kCells % kCells, i / kCells / kCells);
    const Eigen::Vector3d point = kBox.min().array() + (cell + 0.5) / kCells * kBox.sizes().array();
    sum += (estimate * point - gold * point).squaredNorm();
  }
  // The midpoint rule falls short of the spread within its cells: 1 / kCells^2 = 6e-4 of the rotation's part.
  EXPECT_NEAR(targetRegistrationError(estimate, gold, kBox) / std::sqrt(sum / std::pow(kCells, 3)), 1.0, 6e-4);
}

TEST(TargetRegistrationError, ClosedForms)
{
  const RigidTransform gold = makeRigidTransform({ 1.0, 2.0, 3.0 }, { 0.5, -0.5, 0.5, -0.5 });
  EXPECT_EQ(targetRegistrationError(gold, gold, kBox), 0.0);
  EXPECT_NEAR(targetRegistrationError(Eigen::Translation3d(2.0, 3.0, 6.0) * gold, gold, kBox), 7.0, 1e-12);
  // Half a turn about z through the centre of a box of edges 6, 8: mean of 4 (x^2 + y^2) = 4 (36 + 64) / 12.
  const Eigen::AlignedBox3d box(Eigen::Vector3d(-3.0, -4.0, -5.0), Eigen::Vector3d(3.0, 4.0, 5.0));
  const RigidTransform turned(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()));
  EXPECT_NEAR(targetRegistrationError(turned, RigidTransform::Identity(), box), std::sqrt(100.0 / 3.0), 1e-12);
}

TEST(Statistics, QuantilesAreNumpys)
{
  // numpy.quantile([3, 1, 4, 1.5, 9, 2.6], q)
  const std::vector<double> values{ 3.0, 1.0, 4.0, 1.5, 9.0, 2.6 };
  const double expected[][2] = { { 0.0, 1.0 }, { 0.05, 1.125 }, { 0.25, 1.775 },
                                 { 0.5, 2.8 }, { 0.95, 7.75 },  { 1.0, 9.0 } };
  for (const auto& [q, value] : expected)
  {
    EXPECT_NEAR(quantile(values, q), value, 1e-12);
  }
  EXPECT_EQ(quantile({ 7.0 }, 0.3), 7.0);
  expectError<std::invalid_argument>([] { quantile({}, 0.5); }, { "one or more" });
  expectError<std::invalid_argument>([] { quantile({ 1.0, kNan }, 0.5); }, { "NaN" });
  expectError<std::invalid_argument>([] { quantile({ 1.0 }, 1.1); }, { "1.1", "0 to 1" });
  expectError<std::invalid_argument>([] { quantile({ 1.0 }, kNan); }, { "nan", "0 to 1" });
}

TEST(Statistics, PairedTTestIsScipys)
{
  // scipy.stats.ttest_rel
  PairedTTest test = pairedTTest({ 0.31, 0.42, 0.28, 0.55, 0.61, 0.39, 0.47, 0.33, 0.52, 0.44 },
                                 { 0.35, 0.40, 0.41, 0.62, 0.60, 0.51, 0.55, 0.30, 0.66, 0.49 });
  EXPECT_NEAR(test.t, -2.8817950952048883, 1e-9);
  EXPECT_NEAR(test.p, 0.018124925778854547, 1e-9);
  EXPECT_EQ(test.n, 10);
  // Hollander and Wolfe 1973, p. 29: Hamilton depression scale of nine patients at two visits.
  test = pairedTTest({ 1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30 },
                     { 0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29 });
  EXPECT_NEAR(test.t, 3.0353754156485917, 1e-9);
  EXPECT_NEAR(test.p, 0.016176627434908095, 1e-9);

  test = pairedTTest({ 1.0, 2.0, 4.0 }, { 1.0, 2.0, 4.0 });
  EXPECT_EQ(test.t, 0.0);
  EXPECT_EQ(test.p, 1.0);
  test = pairedTTest({ 1.0, 2.0, 4.0 }, { 2.0, 3.0, 5.0 });
  EXPECT_EQ(test.t, -std::numeric_limits<double>::infinity());
  EXPECT_EQ(test.p, 0.0);

  expectError<std::invalid_argument>([] { pairedTTest({ 1.0 }, { 2.0 }); }, { "1 and 1", "two or more" });
  expectError<std::invalid_argument>([] { pairedTTest({ 1.0, 2.0 }, { 2.0 }); }, { "2 and 1", "two or more" });
  expectError<std::invalid_argument>([] { pairedTTest({ 1.0, kNan }, { 2.0, 3.0 }); }, { "finite" });
}

TEST(Summary, CountsFramesAfterTheFirst)
{
  const std::vector<MethodSummary> summaries = summarize(exampleEvaluation());
  ASSERT_EQ(summaries.size(), 3u);
  const MethodSummary& uncorrected = summaries[0];
  EXPECT_EQ(uncorrected.method, "uncorrected");
  EXPECT_EQ(uncorrected.frames, 5);
  ASSERT_EQ(uncorrected.tre_mm.size(), 5u);
  EXPECT_NEAR(uncorrected.tre_mm[4], 5.0, 1e-9);
  EXPECT_EQ(uncorrected.within_1_2_mm, 0.2);
  EXPECT_EQ(uncorrected.within_2_4_mm, 0.4);

  const MethodSummary& good = summaries[1];
  EXPECT_EQ(good.within_1_2_mm, 1.0);
  EXPECT_NEAR(quantile(good.tre_mm, 0.5), 0.3, 1e-9);
  EXPECT_EQ(good.cpu_s.first, 0.4);
  EXPECT_NEAR(good.cpu_s.median, 0.003, 1e-12);
  EXPECT_NEAR(good.cpu_s.mean, 0.003, 1e-12);
  EXPECT_NEAR(good.cpu_s.max, 0.005, 1e-12);
  EXPECT_NEAR(good.wall_s.max, 0.010, 1e-12);

  const MethodSummary& poor = summaries[2];
  EXPECT_EQ(poor.frames, 5);
  EXPECT_EQ(poor.lost, 1);
  EXPECT_EQ(poor.failed, 2);  // the NaN among them
  EXPECT_EQ(poor.tre_mm.size(), 2u);
  EXPECT_EQ(poor.within_1_2_mm, 0.2);  // of all judged frames
  EXPECT_EQ(poor.within_2_4_mm, 0.4);
  EXPECT_EQ(poor.cpu_s.max, 0.9);  // a lost frame took its time
}

TEST(Summary, RejectsWhatDisagrees)
{
  const auto expectRejected = [](void (*spoil)(Evaluation&), const std::vector<std::string>& parts)
  {
    Evaluation evaluation = exampleEvaluation();
    spoil(evaluation);
    expectError<std::invalid_argument>([&] { summarize(evaluation); }, parts);
  };
  expectRejected([](Evaluation& e) { e.methods[1].frames.pop_back(); }, { "poor", "5 frames", "expected 6" });
  expectRejected([](Evaluation& e) { e.gold_standard.pop_back(); }, { "gold standard", "5 frames", "expected 6" });
  expectRejected([](Evaluation& e) { e.gold_standard[2].translation().y() = kNan; }, { "gold standard", "finite" });
  expectRejected([](Evaluation& e) { e.stamps_ns[3] = e.stamps_ns[2]; }, { "1700000001123456789", "frame 3", "grow" });
  expectRejected([](Evaluation& e) { e.methods[1].method = "good"; }, { "'good'", "no other" });
  expectRejected([](Evaluation& e) { e.methods[1].method = "uncorrected"; }, { "'uncorrected'", "no other" });
  expectRejected([](Evaluation& e) { e.methods[1].method = "a,b"; }, { "'a,b'", "comma" });
}

TEST(EvaluationFiles, Tables)
{
  const TemporaryFolder folder;
  const Evaluation evaluation = exampleEvaluation();
  writeEvaluation(evaluation, folder.path("new/results"));

  const auto tre = readTable(folder.path("new/results/tre.csv"));
  ASSERT_EQ(tre.size(), 1u + 6u * 3u);
  EXPECT_EQ(tre[0],
            (std::vector<std::string>{ "frame", "stamp_s", "method", "tre_mm", "uncorrected_mm", "translation_error_mm",
                                       "rotation_error_deg", "status", "cpu_s", "wall_s" }));
  const auto poses = readTable(folder.path("new/results/poses.csv"));
  ASSERT_EQ(poses.size(), tre.size());
  EXPECT_EQ(poses[0], (std::vector<std::string>{ "frame", "stamp_s", "method", "tx_mm", "ty_mm", "tz_mm", "qx", "qy",
                                                 "qz", "qw" }));
  for (std::size_t row = 1; row < tre.size(); ++row)
  {
    const std::size_t frame = (row - 1) / 3;
    const std::size_t method = (row - 1) % 3;
    const char* const names[] = { "uncorrected", "good", "poor" };
    ASSERT_EQ(tre[row].size(), 10u);
    ASSERT_EQ(poses[row].size(), 10u);
    for (const auto& fields : { tre[row], poses[row] })
    {
      EXPECT_EQ(fields[0], std::to_string(frame));
      EXPECT_EQ(fields[1], frame % 2 == 0 ? "170000000" + std::to_string(frame / 2) + ".123456789"
                                          : "170000000" + std::to_string(frame / 2) + ".623456789");
      EXPECT_EQ(fields[2], names[method]);
    }
    EXPECT_NEAR(std::stod(tre[row][4]), double(frame), 1e-6);
    if (method == 2 && frame >= 3)
    {
      EXPECT_EQ(tre[row][7], frame == 3 ? "lost" : "failed");
      for (const int column : { 3, 5, 6 })
      {
        EXPECT_EQ(tre[row][column], "");
      }
      EXPECT_EQ(poses[row][3], "");
      continue;
    }
    const double error = (method == 0 ? 1.0 : method == 1 ? 0.1 : 1.0) * frame;
    EXPECT_EQ(tre[row][7], "ok");
    EXPECT_NEAR(std::stod(tre[row][3]), error, 1e-6);
    EXPECT_NEAR(std::stod(tre[row][5]), error, 1e-6);
    EXPECT_NEAR(std::stod(tre[row][6]), 0.0, 1e-5);

    const RigidTransform pose = makeRigidTransform(
        { std::stod(poses[row][3]), std::stod(poses[row][4]), std::stod(poses[row][5]) },
        { std::stod(poses[row][9]), std::stod(poses[row][6]), std::stod(poses[row][7]), std::stod(poses[row][8]) });
    const RigidTransform& expected =
        method == 0 ? evaluation.gold_standard[0] : evaluation.methods[method - 1].frames[frame].room_from_patient;
    EXPECT_LT((pose.matrix() - expected.matrix()).norm(), 1e-6);
  }
}

TEST(EvaluationFiles, RotationAndTranslationErrors)
{
  const TemporaryFolder folder;
  Evaluation evaluation = exampleEvaluation();
  Twist twist;
  twist << 0.0, 0.0, M_PI / 180.0, 0.3, 0.0, 0.4;
  evaluation.methods[0].frames[2].room_from_patient = evaluation.gold_standard[2] * motionAbout(kBox.center(), twist);
  writeEvaluation(evaluation, folder.path());
  const auto row = readTable(folder.path("tre.csv")).at(1 + 2 * 3 + 1);
  EXPECT_NEAR(std::stod(row[5]), 0.5, 1e-6);  // at the target, not at the far-off origin
  EXPECT_NEAR(std::stod(row[6]), 1.0, 1e-6);
  const double turn = 2.0 * std::sin(M_PI / 360.0);
  EXPECT_NEAR(std::stod(row[3]), std::sqrt(0.25 + turn * turn * (48.0 * 48.0 + 56.0 * 56.0) / 12.0), 1e-6);
}

TEST(EvaluationFiles, SummaryIsJson)
{
  const TemporaryFolder folder;
  writeEvaluation(exampleEvaluation(), folder.path());
  boost::property_tree::ptree json;
  boost::property_tree::read_json(folder.path("summary.json"), json);
  EXPECT_EQ(json.get<std::string>("sequence"), "a \"quoted\" \\ name");
  EXPECT_EQ(json.get<int>("frames"), 6);
  const auto& methods = json.get_child("methods");
  EXPECT_EQ(methods.size(), 3u);
  const auto& good = methods.get_child("good");
  EXPECT_NEAR(good.get<double>("tre_mm.mean"), 0.3, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.median"), 0.3, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.p25"), 0.2, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.p75"), 0.4, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.p95"), 0.48, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.min"), 0.1, 1e-9);
  EXPECT_NEAR(good.get<double>("tre_mm.max"), 0.5, 1e-9);
  EXPECT_EQ(good.get<double>("within_1_2_mm"), 1.0);
  EXPECT_NEAR(good.get<double>("cpu_s.first"), 0.4, 1e-9);
  EXPECT_NEAR(good.get<double>("wall_s.median"), 0.006, 1e-9);
  EXPECT_EQ(methods.get<int>("poor.lost"), 1);
  EXPECT_EQ(methods.get<int>("poor.failed"), 2);
  EXPECT_EQ(methods.get<double>("poor.within_2_4_mm"), 0.4);
  const auto& tests = json.get_child("paired_t_test");
  EXPECT_EQ(tests.size(), 3u);
  const auto& test = tests.get_child("uncorrected vs good");
  // Differences 0.9 mm times 1..5: mean 2.7, standard deviation 0.9 sqrt(2.5).
  EXPECT_NEAR(test.get<double>("t"), 2.7 / (0.9 * std::sqrt(2.5) / std::sqrt(5.0)), 1e-6);
  EXPECT_EQ(test.get<int>("n"), 5);
  EXPECT_EQ(tests.get<int>("good vs poor.n"), 2);
  EXPECT_EQ(json.count("gate"), 0u);
}

TEST(EvaluationFiles, SummaryTellsOfTheGate)
{
  const TemporaryFolder folder;
  Evaluation evaluation = exampleEvaluation();
  evaluation.gate = GateCounts{ 4, 3 };
  writeEvaluation(evaluation, folder.path());
  boost::property_tree::ptree json;
  boost::property_tree::read_json(folder.path("summary.json"), json);
  EXPECT_EQ(json.get<int>("gate.verified"), 4);
  EXPECT_EQ(json.get<int>("gate.open"), 3);
  EXPECT_EQ(json.get_child("paired_t_test").size(), 3u);
  EXPECT_NE(formatTable(evaluation).find("of 6 exposures 4 verified, open in 3\n"), std::string::npos);
}

TEST(EvaluationFiles, WithoutGoldStandardOrFramesThereAreNulls)
{
  const TemporaryFolder folder;
  Evaluation evaluation = exampleEvaluation();
  evaluation.gold_standard.clear();
  evaluation.methods[0].frames[1].cpu_s = kNan;
  for (const bool has_frames : { true, false })
  {
    if (!has_frames)
    {
      evaluation.stamps_ns.clear();
      evaluation.methods[0].frames.clear();
      evaluation.methods[1].frames.clear();
    }
    writeEvaluation(evaluation, folder.path());
    boost::property_tree::ptree json;
    boost::property_tree::read_json(folder.path("summary.json"), json);
    EXPECT_EQ(json.get_child("methods").size(), 2u);  // no uncorrected
    EXPECT_EQ(json.get<std::string>("methods.good.tre_mm.mean"), "null");
    EXPECT_EQ(json.get<std::string>("methods.good.within_1_2_mm"), "null");
    EXPECT_EQ(json.get<std::string>("methods.good.cpu_s.max") == "null", !has_frames);
    EXPECT_EQ(json.get<std::string>("paired_t_test.good vs poor.p"), "null");
    EXPECT_EQ(readTable(folder.path("poses.csv")).size(), has_frames ? 13u : 1u);
    for (const auto& row : readTable(folder.path("tre.csv")))
    {
      for (const std::string& field : row)
      {
        EXPECT_EQ(field.find("nan"), std::string::npos);
      }
    }
    EXPECT_NE(formatTable(evaluation).find(" - "), std::string::npos);
  }

  folder.write("file", "");
  expectError<std::runtime_error>([&] { writeEvaluation(evaluation, folder.path("file")); }, { "file" });
}

TEST(EvaluationTable, IsAligned)
{
  std::istringstream table(formatTable(exampleEvaluation()));
  std::vector<std::string> lines;
  for (std::string line; std::getline(table, line);)
  {
    lines.push_back(line);
  }
  ASSERT_EQ(lines.size(), 4u);
  for (const std::string& line : lines)
  {
    EXPECT_EQ(line.size(), lines[0].size());
  }
  // Each value ends under its heading.
  const auto endOf = [](const std::string& line, const std::string& text) { return line.find(text) + text.size(); };
  EXPECT_EQ(lines[2].substr(0, 4), "good");
  EXPECT_EQ(endOf(lines[2], "0.300"), endOf(lines[0], "TRE median"));
  EXPECT_EQ(endOf(lines[2], "0.480"), endOf(lines[0], "p95"));
  EXPECT_EQ(endOf(lines[2], "100 %"), endOf(lines[0], "< 1.2 mm"));
  EXPECT_EQ(endOf(lines[2], "3.00"), endOf(lines[0], "cpu median ms"));
  EXPECT_EQ(endOf(lines[2], "6.00"), endOf(lines[0], "wall median ms"));
}
}  // namespace
}  // namespace xray_tracking
