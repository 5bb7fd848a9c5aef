#include "follow.h"

#include <cmath>
#include <limits>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/stopwatch.h"

namespace xray_tracking
{
namespace
{
constexpr int kTrainings = 3;
}  // namespace

FollowScore follow(Contestant& contestant, const std::vector<KnownSequence>& sequences, double lost_error)
{
  std::vector<double> training_s, tracking_s;
  FollowScore score;
  double squares = 0.0;
  int found = 0;
  for (const KnownSequence& sequence : sequences)
  {
    for (int i = 0; i < kTrainings; ++i)
    {
      const Stopwatch stopwatch;
      contestant.train(sequence.frames[0], sequence.view);
      training_s.push_back(stopwatch.cpuSeconds());
    }
    for (std::size_t k = 1; k < sequence.frames.size(); ++k)
    {
      const Stopwatch stopwatch;
      const std::optional<Eigen::Vector2d> displacement = contestant.track(sequence.frames[k]);
      tracking_s.push_back(stopwatch.cpuSeconds());
      const double error =
          displacement ? (*displacement - sequence.displacements[k]).norm() : std::numeric_limits<double>::infinity();
      if (!(error <= lost_error))
      {
        ++score.lost;
        contestant.restart();
        continue;
      }
      ++found;
      squares += error * error;
    }
  }
  score.training_ms = 1e3 * quantile(training_s, 0.5);
  score.median_us = 1e6 * quantile(tracking_s, 0.5);
  score.rmse = found > 0 ? std::sqrt(squares / found) : std::numeric_limits<double>::quiet_NaN();
  return score;
}
}  // namespace xray_tracking
