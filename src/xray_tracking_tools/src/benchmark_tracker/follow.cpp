#include "follow.h"

#include <cmath>
#include <limits>

#include <time.h>

#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr int kTrainings = 3;

double processorSeconds()
{
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}
}  // namespace

FollowScore follow(Contestant& contestant, const KnownSequence& sequence, double lost_error)
{
  std::vector<double> training_s, tracking_s;
  for (int i = 0; i < kTrainings; ++i)
  {
    const double start = processorSeconds();
    contestant.train(sequence.frames[0], sequence.view);
    training_s.push_back(processorSeconds() - start);
  }

  FollowScore score;
  double squares = 0.0;
  int found = 0;
  for (std::size_t k = 1; k < sequence.frames.size(); ++k)
  {
    const double start = processorSeconds();
    const std::optional<Eigen::Vector2d> displacement = contestant.track(sequence.frames[k]);
    tracking_s.push_back(processorSeconds() - start);
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
  score.training_ms = 1e3 * quantile(training_s, 0.5);
  score.median_us = 1e6 * quantile(tracking_s, 0.5);
  score.rmse = found > 0 ? std::sqrt(squares / found) : std::numeric_limits<double>::quiet_NaN();
  return score;
}
}  // namespace xray_tracking
