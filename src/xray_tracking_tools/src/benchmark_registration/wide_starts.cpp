#include "wide_starts.h"

#include <algorithm>

#include "starts.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
namespace
{
constexpr double kOff = 25.0;  // [mm]
constexpr double kTurned = 10.0 * kDegree;

double shareBelow(const std::vector<double>& errors, double limit)
{
  const auto below = std::count_if(errors.begin(), errors.end(), [&](double error) { return error < limit; });
  return 100.0 * static_cast<double>(below) / static_cast<double>(errors.size());
}
}  // namespace

FigureTable measureWideStarts(const Subject& subject, const Registration& registration, int count,
                              std::vector<Trial>& trials)
{
  std::mt19937 random(3);
  std::uniform_real_distribution<double> share(-1.0, 1.0);
  std::vector<double> errors, rivals, wall, cpu;
  double believed = 0.0, falsely = 0.0;
  Progress progress("wide search");
  for (int n = 0; n < count; ++n)
  {
    const std::size_t index = static_cast<std::size_t>(n) % subject.exposures.images.size();
    const RigidTransform& gold = subject.exposures.room_from_patient[index];
    Twist off;
    for (int axis = 0; axis < 6; ++axis)
    {
      off[axis] = share(random) * (axis < 3 ? kTurned : kOff);
    }
    RegistrationRequest request = requestFor(subject.exposures, index, subject.moved(off, gold));
    request.search = Search::WIDE;
    request.max_translation_mm = kUsualSearch;
    request.max_rotation_rad = kUsualSearchRotation;
    Trial trial = tryRegistration(registration, request, gold, subject.box());
    trial.subject = subject.name;
    trial.kind = "wide";
    errors.push_back(trial.error);
    rivals.push_back(
        trial.result.rivals.empty() ? 0.0 : trial.result.rivals.front().similarity / trial.result.similarity_after);
    wall.push_back(1e3 * trial.result.duration.count());
    cpu.push_back(trial.cpu_ms);
    believed += trial.believed();
    falsely += trial.believed() && trial.error > kFalseSuccess;
    trials.push_back(std::move(trial));
    progress(n + 1, count);
  }
  FigureTable table("wide searches from starts up to 25 mm and 10 degrees off along and about every axis");
  table.beginRow();
  table.add("starts", count, 0);
  table.add("TRE median", quantile(errors, 0.5));
  table.add("p95", quantile(errors, 0.95));
  table.add("max", quantile(errors, 1.0));
  table.add("< 1 mm %", shareBelow(errors, 1.0), 1);
  table.add("< 1.2 mm %", shareBelow(errors, 1.2), 1);
  table.add("believed %", 100.0 * believed / count, 1);
  table.add("believed > 1.5 mm", falsely, 0);
  table.add("rival's similarity / answer's p95", quantile(rivals, 0.95));
  table.add("wall ms", quantile(wall, 0.5), 1);
  table.add("wall p95", quantile(wall, 0.95), 1);
  table.add("CPU ms", quantile(cpu, 0.5), 1);
  table.add("CPU p95", quantile(cpu, 0.95), 1);
  return table;
}
}  // namespace xray_tracking
