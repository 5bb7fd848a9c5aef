#include "wide_search.h"

#include <algorithm>
#include <cmath>

#include "rivalry.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr std::size_t kPlaces = 60;
constexpr int kDescents = 6;     // at most
constexpr double kBehind = 0.1;  // in PoseSearch::similarity(): places that are not worth a descent
constexpr double kMet = 1.0;     // apart [mm]
constexpr int kMeetings = 3;
// Shares of the target's size, the root mean square distance of its box from its centre: places nearer to the answer
// than the first lead to it; ends nearer to each other than the second are one place, not well told. The next vertebra
// is farther away than both.
constexpr double kNearby = 0.6;
constexpr double kSame = 0.3;
}  // namespace

Found searchAround(const Run& run, const Bodies& bodies, const Descender& descender,
                   const Eigen::AlignedBox3d& target_box, const PosePair& start, const SearchBounds& bounds)
{
  Found found;
  found.answer.poses = start;
  found.answer.doubt = "no place in the neighbourhood shows the target in all views";
  const PoseSearch search(run, bodies, target_box, start, bounds, descender.together());
  const auto apart = [&](const PosePair& a, const PosePair& b)
  { return targetRegistrationError(a.target, b.target, target_box); };
  const double size = target_box.sizes().norm() / std::sqrt(12.0);
  std::vector<Outcome> ends;
  double similarity = 0.0;  // of the answer, as the search has it
  int descents = 0;
  int met = 0;         // descents that ended where the answer is
  bool rival = false;  // is known
  for (const Place& place : search.places(kPlaces))
  {
    if (descents == kDescents || run.control.stop() != RunControl::Stop::NONE)
    {
      break;
    }
    // Where a descent is believed, or three have met, no further one is needed from nearby.
    const bool settled = found.answer.doubt.empty() || met >= kMeetings;
    if (settled && apart(place.poses, found.answer.poses) < kNearby * size)
    {
      continue;
    }
    // One rival is looked at however far behind it is.
    if (settled && rival && place.similarity < similarity - kBehind)
    {
      break;
    }
    Outcome end = descender.descend(run, place.poses, Path::COARSE);
    ++descents;
    const double from_answer = apart(end.poses, found.answer.poses);
    rival = rival || (settled && from_answer > kSame * size);
    const bool there = from_answer < kMet;
    if (end.similarity > found.answer.similarity)
    {
      found.answer = end;
      similarity = search.similarity(end.poses);
      met = there ? met : 0;
    }
    met += apart(end.poses, found.answer.poses) < kMet ? 1 : 0;
    ends.push_back(std::move(end));
  }
  if (found.answer.views.empty() && !ends.empty())
  {
    found.answer.doubt = ends.front().doubt;
  }
  std::sort(ends.begin(), ends.end(), [](const Outcome& a, const Outcome& b) { return a.similarity > b.similarity; });
  for (const Outcome& end : ends)
  {
    const bool own = end.views.empty() || apart(end.poses, found.answer.poses) < kSame * size ||
                     std::any_of(found.rivals.begin(), found.rivals.end(),
                                 [&](const Rival& rival) {
                                   return targetRegistrationError(rival.room_from_patient, end.poses.target,
                                                                  target_box) < kSame * size;
                                 });
    if (!own)
    {
      found.rivals.push_back(rivalFrom(end));
    }
  }
  return found;
}
}  // namespace xray_tracking
