#include "capture_range.h"

#include <algorithm>
#include <limits>

#include "starts.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
/// van de Kraats et al., IEEE TMI 24(9), 2005: a registration below this error [mm] has succeeded.
constexpr double kSuccess = 2.0;
constexpr double kBandWidth = 2.0;  ///< of the starts' distances [mm]

void addFigures(FigureTable& table, const std::vector<Trial>& trials)
{
  std::vector<double> errors, successes, wall, cpu;
  int within = 0, believed = 0, falsely = 0;
  for (const Trial& trial : trials)
  {
    errors.push_back(trial.error);
    wall.push_back(1e3 * trial.result.duration.count());
    cpu.push_back(trial.cpu_ms);
    within += trial.error < 1.0;
    believed += trial.believed();
    falsely += trial.believed() && trial.error > kFalseSuccess;
    if (trial.error < kSuccess)
    {
      successes.push_back(trial.error);
    }
  }
  const double count = static_cast<double>(trials.size());
  table.add("starts", count, 0);
  table.add("success %", 100.0 * successes.size() / count, 1);
  table.add("mean TRE of successes",
            successes.empty() ? std::numeric_limits<double>::quiet_NaN() : cv::mean(successes)[0]);
  table.add("TRE median", quantile(errors, 0.5));
  table.add("p95", quantile(errors, 0.95));
  table.add("max", quantile(errors, 1.0));
  table.add("< 1 mm %", 100.0 * within / count, 1);
  table.add("believed %", 100.0 * believed / count, 1);
  table.add("believed > 1.5 mm", falsely, 0);
  table.add("wall ms", quantile(wall, 0.5), 1);
  table.add("wall p95", quantile(wall, 0.95), 1);
  table.add("CPU ms", quantile(cpu, 0.5), 1);
  table.add("CPU p95", quantile(cpu, 0.95), 1);
}
}  // namespace

FigureTable measureCaptureRange(const Subject& subject, const Registration& registration, int count,
                                std::vector<Trial>& trials)
{
  constexpr double kMaxDistance = 16.0;
  constexpr double kMaxAngle = 10.0 * kDegree;
  constexpr int kBands = static_cast<int>(kMaxDistance / kBandWidth);
  std::mt19937 random(1);
  FigureTable table("starts of 0 to 16 mm and 0 to 10 degrees, success below 2 mm");
  std::vector<Trial> all;
  double capture_range = 0.0;
  bool captured = true;
  for (int band = 0; band < kBands; ++band)
  {
    const double low = band * kBandWidth;
    const std::string name =
        std::to_string(static_cast<int>(low)) + " to " + std::to_string(static_cast<int>(low + kBandWidth)) + " mm";
    const std::vector<Trial> of_band =
        registerAll(subject, registration,
                    startsOfBand(subject, low, low + kBandWidth, kMaxAngle, (count + kBands - 1) / kBands, random),
                    all.size(), name);
    table.beginRow();
    table.add("start", name);
    addFigures(table, of_band);
    const auto successes =
        std::count_if(of_band.begin(), of_band.end(), [](const Trial& trial) { return trial.error < kSuccess; });
    captured = captured && successes >= 0.95 * static_cast<double>(of_band.size());
    capture_range = captured ? low + kBandWidth : capture_range;
    all.insert(all.end(), of_band.begin(), of_band.end());
  }
  table.beginRow();
  table.add("start", std::string("all"));
  addFigures(table, all);
  table.add("capture range 95 % [mm]", capture_range, 0);
  trials.insert(trials.end(), all.begin(), all.end());
  return table;
}

FigureTable measureRefinement(const Subject& subject, const Registration& registration, int count,
                              std::vector<Trial>& trials)
{
  FigureTable table("starts of one size");
  std::mt19937 random(2);
  for (const auto& [millimetres, degrees] : { std::pair(2, 1), std::pair(5, 3), std::pair(10, 5) })
  {
    std::vector<Twist> starts;
    for (int n = 0; n < count; ++n)
    {
      starts.push_back(randomTwist(random, degrees * kDegree, millimetres));
    }
    const std::string name = std::to_string(millimetres) + " mm; " + std::to_string(degrees) + " degrees";
    table.beginRow();
    table.add("start", name);
    const std::vector<Trial> of_size = registerAll(subject, registration, starts, 0, name);
    addFigures(table, of_size);
    trials.insert(trials.end(), of_size.begin(), of_size.end());
  }
  return table;
}
}  // namespace xray_tracking
