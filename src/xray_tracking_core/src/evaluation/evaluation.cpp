#include "xray_tracking_core/evaluation/evaluation.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <locale>
#include <set>
#include <sstream>
#include <stdexcept>

#include "judged_method.h"

namespace xray_tracking
{
namespace
{
const char* const kUncorrected = "uncorrected";

void checkEvaluation(const Evaluation& evaluation)
{
  const std::size_t frames = evaluation.stamps_ns.size();
  const auto checkFrames = [&](const std::string& what, std::size_t size)
  {
    if (size != frames)
    {
      throw std::invalid_argument("evaluation: " + what + " has " + std::to_string(size) + " frames: expected " +
                                  std::to_string(frames));
    }
  };
  for (std::size_t i = 0; i < frames; ++i)
  {
    if (evaluation.stamps_ns[i] < 0 || (i > 0 && evaluation.stamps_ns[i] <= evaluation.stamps_ns[i - 1]))
    {
      throw std::invalid_argument("evaluation: stamp " + std::to_string(evaluation.stamps_ns[i]) + " ns of frame " +
                                  std::to_string(i) + ": expected stamps that grow from 0");
    }
  }
  if (!evaluation.gold_standard.empty())
  {
    checkFrames("gold standard", evaluation.gold_standard.size());
    if (!std::all_of(evaluation.gold_standard.begin(), evaluation.gold_standard.end(), isRigid))
    {
      throw std::invalid_argument("evaluation: gold standard: expected finite rigid poses");
    }
  }
  std::set<std::string> names{ kUncorrected };
  for (const MethodResult& method : evaluation.methods)
  {
    checkFrames("method " + method.method, method.frames.size());
    if (method.method.empty() || method.method.find_first_of(",\"\r\n") != std::string::npos ||
        !names.insert(method.method).second)
    {
      throw std::invalid_argument("evaluation: method '" + method.method +
                                  "': expected a name without comma or quote that no other method has");
    }
  }
}

JudgedMethod judge(const Evaluation& evaluation, const MethodResult& method)
{
  JudgedMethod judged{ method.method, method.frames, {} };
  for (std::size_t i = 0; i < judged.frames.size(); ++i)
  {
    FrameResult& frame = judged.frames[i];
    if (frame.status == FrameStatus::OK && !isRigid(frame.room_from_patient))
    {
      frame.status = FrameStatus::FAILED;
    }
    judged.tre_mm.push_back(
        frame.status == FrameStatus::OK && !evaluation.gold_standard.empty()
            ? targetRegistrationError(frame.room_from_patient, evaluation.gold_standard[i], evaluation.target_box)
            : std::numeric_limits<double>::quiet_NaN());
  }
  return judged;
}

TimeSummary summarizeTimes(const std::vector<FrameResult>& frames, double FrameResult::*time)
{
  std::vector<double> times;
  for (std::size_t i = 1; i < frames.size(); ++i)
  {
    if (frames[i].status != FrameStatus::FAILED && std::isfinite(frames[i].*time))
    {
      times.push_back(frames[i].*time);
    }
  }
  const double first = frames.empty() ? std::numeric_limits<double>::quiet_NaN() : frames.front().*time;
  return { first, quantileOrNan(times, 0.5), meanOrNan(times), quantileOrNan(times, 1.0) };
}

MethodSummary summarizeMethod(const JudgedMethod& method, bool has_gold_standard)
{
  MethodSummary summary;
  summary.method = method.name;
  for (std::size_t i = 1; i < method.frames.size(); ++i)
  {
    ++summary.frames;
    summary.lost += method.frames[i].status == FrameStatus::LOST;
    summary.failed += method.frames[i].status == FrameStatus::FAILED;
    if (std::isfinite(method.tre_mm[i]))
    {
      summary.tre_mm.push_back(method.tre_mm[i]);
    }
  }
  const auto shareWithin = [&](double bound)
  {
    if (!has_gold_standard || summary.frames == 0)
    {
      return std::numeric_limits<double>::quiet_NaN();
    }
    const auto within =
        std::count_if(summary.tre_mm.begin(), summary.tre_mm.end(), [bound](double tre) { return tre < bound; });
    return static_cast<double>(within) / summary.frames;
  };
  summary.within_1_2_mm = shareWithin(1.2);
  summary.within_2_4_mm = shareWithin(2.4);
  summary.cpu_s = summarizeTimes(method.frames, &FrameResult::cpu_s);
  summary.wall_s = summarizeTimes(method.frames, &FrameResult::wall_s);
  return summary;
}
}  // namespace

double targetRegistrationError(const RigidTransform& estimate, const RigidTransform& gold,
                               const Eigen::AlignedBox3d& target_box)
{
  // The distance's square is that at the centre plus, along each edge of length l, the spread of a uniform
  // distribution, l^2 / 12, turned by the difference of the rotations; mixed terms vanish over a box.
  const Eigen::Vector3d at_centre = estimate * target_box.center() - gold * target_box.center();
  const Eigen::Matrix3d turn = estimate.linear() - gold.linear();
  const Eigen::Vector3d variances = target_box.sizes().cwiseAbs2() / 12.0;
  return std::sqrt(at_centre.squaredNorm() + turn.colwise().squaredNorm().dot(variances));
}

std::vector<JudgedMethod> judgeMethods(const Evaluation& evaluation)
{
  checkEvaluation(evaluation);
  std::vector<JudgedMethod> judged;
  if (!evaluation.gold_standard.empty())
  {
    FrameResult frame;
    frame.status = FrameStatus::OK;
    frame.room_from_patient = evaluation.gold_standard.front();
    judged.push_back(judge(evaluation, { kUncorrected, { evaluation.gold_standard.size(), frame } }));
  }
  for (const MethodResult& method : evaluation.methods)
  {
    judged.push_back(judge(evaluation, method));
  }
  return judged;
}

std::vector<MethodSummary> summarize(const Evaluation& evaluation)
{
  std::vector<MethodSummary> summaries;
  for (const JudgedMethod& method : judgeMethods(evaluation))
  {
    summaries.push_back(summarizeMethod(method, !evaluation.gold_standard.empty()));
  }
  return summaries;
}

std::string formatTable(const Evaluation& evaluation)
{
  std::vector<std::vector<std::string>> rows{ { "method", "TRE median", "p95", "max", "mean mm", "< 1.2 mm", "< 2.4 mm",
                                                "lost", "failed", "cpu median ms", "wall median ms" } };
  const auto number = [](double value, int digits)
  {
    if (!std::isfinite(value))
    {
      return std::string("-");
    }
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text << std::fixed << std::setprecision(digits) << value;
    return text.str();
  };
  const auto share = [&](double value) { return std::isfinite(value) ? number(100.0 * value, 0) + " %" : "-"; };
  for (const MethodSummary& summary : summarize(evaluation))
  {
    rows.push_back({ summary.method, number(quantileOrNan(summary.tre_mm, 0.5), 3),
                     number(quantileOrNan(summary.tre_mm, 0.95), 3), number(quantileOrNan(summary.tre_mm, 1.0), 3),
                     number(meanOrNan(summary.tre_mm), 3), share(summary.within_1_2_mm), share(summary.within_2_4_mm),
                     std::to_string(summary.lost), std::to_string(summary.failed),
                     number(1000.0 * summary.cpu_s.median, 2), number(1000.0 * summary.wall_s.median, 2) });
  }

  std::ostringstream table;
  for (const auto& row : rows)
  {
    for (std::size_t column = 0; column < row.size(); ++column)
    {
      std::size_t width = 0;
      for (const auto& other : rows)
      {
        width = std::max(width, other[column].size());
      }
      table << (column > 0 ? "  " : "") << (column > 0 ? std::right : std::left) << std::setw(static_cast<int>(width))
            << row[column];
    }
    table << '\n';
  }
  if (evaluation.gate)
  {
    table << "beam gate: of " << evaluation.stamps_ns.size() << " exposures " << evaluation.gate->verified
          << " verified, open in " << evaluation.gate->open << '\n';
  }
  return table.str();
}
}  // namespace xray_tracking
