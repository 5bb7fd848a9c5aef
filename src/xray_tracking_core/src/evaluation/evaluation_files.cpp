#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <limits>
#include <locale>
#include <stdexcept>

#include <nlohmann/json.hpp>

#include "judged_method.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegreesPerRadian = 180.0 / M_PI;

/// A number in a table's field, which is empty where it is not finite.
struct Field
{
  double value;
};

std::ostream& operator<<(std::ostream& out, const Field& field)
{
  return std::isfinite(field.value) ? out << field.value : out;
}

const char* nameOf(FrameStatus status)
{
  switch (status)
  {
    case FrameStatus::OK:
      return "ok";
    case FrameStatus::LOST:
      return "lost";
    case FrameStatus::FAILED:
      break;
  }
  return "failed";
}

/// `frame,stamp_s,method`; every nanosecond is written.
void writeRowStart(std::ostream& out, const Evaluation& evaluation, std::size_t frame, const std::string& method)
{
  const std::int64_t stamp = evaluation.stamps_ns[frame];
  out << frame << ',' << stamp / 1'000'000'000 << '.' << std::setw(9) << std::setfill('0') << stamp % 1'000'000'000
      << ',' << method;
}

void writeErrors(std::ostream& out, const Evaluation& evaluation, const std::vector<JudgedMethod>& methods)
{
  out << "frame,stamp_s,method,tre_mm,uncorrected_mm,translation_error_mm,rotation_error_deg,status,cpu_s,wall_s\n";
  const bool has_gold_standard = !evaluation.gold_standard.empty();
  const Eigen::Vector3d centre = evaluation.target_box.center();
  for (std::size_t i = 0; i < evaluation.stamps_ns.size(); ++i)
  {
    for (const JudgedMethod& method : methods)
    {
      const FrameResult& frame = method.frames[i];
      double uncorrected = std::numeric_limits<double>::quiet_NaN();
      double translation_error = uncorrected;
      double rotation_error = uncorrected;
      if (has_gold_standard)
      {
        uncorrected = methods.front().tre_mm[i];
      }
      if (has_gold_standard && frame.status == FrameStatus::OK)
      {
        const RigidTransform& gold = evaluation.gold_standard[i];
        translation_error = (frame.room_from_patient * centre - gold * centre).norm();
        rotation_error = kDegreesPerRadian * rotationAngle(gold.inverse() * frame.room_from_patient);
      }
      writeRowStart(out, evaluation, i, method.name);
      out << ',' << Field{ method.tre_mm[i] } << ',' << Field{ uncorrected } << ',' << Field{ translation_error } << ','
          << Field{ rotation_error } << ',' << nameOf(frame.status) << ',' << Field{ frame.cpu_s } << ','
          << Field{ frame.wall_s } << '\n';
    }
  }
}

void writePoses(std::ostream& out, const Evaluation& evaluation, const std::vector<JudgedMethod>& methods)
{
  out << "frame,stamp_s,method,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
  for (std::size_t i = 0; i < evaluation.stamps_ns.size(); ++i)
  {
    for (const JudgedMethod& method : methods)
    {
      writeRowStart(out, evaluation, i, method.name);
      if (method.frames[i].status == FrameStatus::OK)
      {
        const RigidTransform& pose = method.frames[i].room_from_patient;
        const Eigen::Quaterniond rotation(pose.linear());
        out << ',' << pose.translation().x() << ',' << pose.translation().y() << ',' << pose.translation().z() << ','
            << rotation.x() << ',' << rotation.y() << ',' << rotation.z() << ',' << rotation.w() << '\n';
      }
      else
      {
        out << ",,,,,,,\n";
      }
    }
  }
}

// A number that is not finite is written as null.
nlohmann::json jsonOf(const TimeSummary& times)
{
  return { { "first", times.first }, { "median", times.median }, { "mean", times.mean }, { "max", times.max } };
}

nlohmann::json jsonOf(const MethodSummary& summary)
{
  const std::vector<double>& tre = summary.tre_mm;
  return { { "tre_mm",
             { { "mean", meanOrNan(tre) },
               { "median", quantileOrNan(tre, 0.5) },
               { "p25", quantileOrNan(tre, 0.25) },
               { "p75", quantileOrNan(tre, 0.75) },
               { "p95", quantileOrNan(tre, 0.95) },
               { "min", quantileOrNan(tre, 0.0) },
               { "max", quantileOrNan(tre, 1.0) } } },
           { "within_1_2_mm", summary.within_1_2_mm },
           { "within_2_4_mm", summary.within_2_4_mm },
           { "lost", summary.lost },
           { "failed", summary.failed },
           { "cpu_s", jsonOf(summary.cpu_s) },
           { "wall_s", jsonOf(summary.wall_s) } };
}

/// Over the frames after the first in which both have an error.
nlohmann::json jsonOfPairedTTest(const JudgedMethod& a, const JudgedMethod& b)
{
  std::vector<double> errors_a;
  std::vector<double> errors_b;
  for (std::size_t i = 1; i < a.tre_mm.size(); ++i)
  {
    if (std::isfinite(a.tre_mm[i]) && std::isfinite(b.tre_mm[i]))
    {
      errors_a.push_back(a.tre_mm[i]);
      errors_b.push_back(b.tre_mm[i]);
    }
  }
  PairedTTest test;
  test.t = test.p = std::numeric_limits<double>::quiet_NaN();
  test.n = static_cast<int>(errors_a.size());
  if (test.n >= 2)
  {
    test = pairedTTest(errors_a, errors_b);
  }
  return { { "t", test.t }, { "p", test.p }, { "n", test.n } };
}

void writeSummary(std::ostream& out, const Evaluation& evaluation, const std::vector<JudgedMethod>& methods)
{
  nlohmann::json json = { { "sequence", evaluation.sequence },
                          { "frames", evaluation.stamps_ns.size() },
                          { "methods", nlohmann::json::object() },
                          { "paired_t_test", nlohmann::json::object() } };
  for (const MethodSummary& summary : summarize(evaluation))
  {
    json["methods"][summary.method] = jsonOf(summary);
  }
  if (evaluation.gate)
  {
    json["gate"] = { { "verified", evaluation.gate->verified }, { "open", evaluation.gate->open } };
  }
  for (std::size_t a = 0; a < methods.size(); ++a)
  {
    for (std::size_t b = a + 1; b < methods.size(); ++b)
    {
      json["paired_t_test"][methods[a].name + " vs " + methods[b].name] = jsonOfPairedTTest(methods[a], methods[b]);
    }
  }
  // Names may come from folders, whose bytes need not be UTF-8.
  out << json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << '\n';
}
}  // namespace

void writeEvaluation(const Evaluation& evaluation, const std::string& directory)
{
  const std::vector<JudgedMethod> methods = judgeMethods(evaluation);
  const std::filesystem::path folder(directory);
  std::filesystem::create_directories(folder);

  using Write = void (*)(std::ostream&, const Evaluation&, const std::vector<JudgedMethod>&);
  const std::pair<const char*, Write> files[] = { { "tre.csv", writeErrors },
                                                  { "poses.csv", writePoses },
                                                  { "summary.json", writeSummary } };
  for (const auto& [name, write] : files)
  {
    std::ofstream file(folder / name);
    file.imbue(std::locale::classic());
    file.precision(10);
    write(file, evaluation, methods);
    file.close();
    if (!file)
    {
      throw std::runtime_error((folder / name).string() + ": cannot be written");
    }
  }
}
}  // namespace xray_tracking
