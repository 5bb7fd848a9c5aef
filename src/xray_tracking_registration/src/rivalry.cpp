#include "rivalry.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "message.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
/// Odds of a place, a unit of the similarity's logarithm: so they are of 764 pairs of the right place and another one
/// (phantom's C3, C5 and C6, the rest 6 mm and 4 degrees away, starts near the target and near its neighbours).
constexpr double kAlike = 25.0;
/// A start is off by about this much, or by more with a long tail [mm].
constexpr double kOff = 5.0;
/// No nearer place is more than ten times as probable by this alone where the start is not verified: it may be at the
/// wrong vertebra.
constexpr double kMostNearer = 2.3;

double nearness(const Run& run, const RigidTransform& room_from_patient)
{
  // Density of a Cauchy distribution in space.
  return run.request.search == Search::WIDE
             ? 0.0
             : -2.0 * std::log(std::hypot(run.control.distance(room_from_patient), kOff));
}
}  // namespace

Rival rivalFrom(const Outcome& place)
{
  Rival rival;
  rival.room_from_patient = place.poses.target;
  rival.similarity = place.similarity;
  return rival;
}

double oddsOver(const Run& run, const Outcome& outcome, const Rival& rival)
{
  constexpr double kLeast = 0.01;
  const double most = run.request.start_verified ? std::numeric_limits<double>::infinity() : kMostNearer;
  const double nearer = nearness(run, outcome.poses.target) - nearness(run, rival.room_from_patient);
  return kAlike * std::log(std::max(kLeast, outcome.similarity) / std::max(kLeast, rival.similarity)) +
         std::clamp(nearer, -most, most);
}

std::vector<Rival> weighRivals(const Run& run, const Eigen::AlignedBox3d& target_box, std::vector<Rival> rivals,
                               double min_probability, Outcome& answer)
{
  for (Rival& rival : rivals)
  {
    rival.distance_mm = targetRegistrationError(rival.room_from_patient, answer.poses.target, target_box);
    rival.rotation_rad = rotationAngle(answer.poses.target.inverse() * rival.room_from_patient);
    rival.odds = oddsOver(run, answer, rival);
  }
  rivals.erase(
      std::remove_if(rivals.begin(), rivals.end(), [](const Rival& rival) { return rival.distance_mm < kElsewhere; }),
      rivals.end());
  std::sort(rivals.begin(), rivals.end(), [](const Rival& a, const Rival& b) { return a.similarity > b.similarity; });
  const auto worst =
      std::min_element(rivals.begin(), rivals.end(), [](const Rival& a, const Rival& b) { return a.odds < b.odds; });
  if (answer.doubt.empty() && worst != rivals.end() && 1.0 / (1.0 + std::exp(-worst->odds)) < min_probability)
  {
    doubtFor(message("a place ", worst->distance_mm, " mm and ", worst->rotation_rad,
                     " rad away may be the right one as well: its similarity is ", worst->similarity, ", here ",
                     answer.similarity),
             answer);
  }
  return rivals;
}
}  // namespace xray_tracking
