#include "wide_search.h"

#include <algorithm>
#include <cmath>

#include "message.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr std::size_t kPlaces = 24;
constexpr int kDescents = 6;     // at most
constexpr double kBehind = 0.1;  // in PoseSearch::similarity(): places that are not worth a descent
constexpr double kMet = 1.0;     // [mm]
/// Ends nearer to each other than this share of the target's size are one place, not well told: no rivals.
constexpr double kApart = 0.25;
/// A rival with more than this share of the answer's similarity is as good. The right place's rivals have 0.2 to 0.6 of
/// it (phantom, thorax), 0.69 (wrist), 0.85 where the next vertebra is most like it.
constexpr double kAsGood = 0.85;

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
  const double distinct = kApart * target_box.sizes().norm();
  std::vector<Outcome> ends;
  double similarity = 0.0;  // of the answer, as the search has it
  int descents = 0;
  bool met = false;    // two descents, where the answer is
  bool rival = false;  // has been looked for elsewhere
  for (const Place& place : search.places(kPlaces))
  {
    if (descents == kDescents || run.control.stop() != RunControl::Stop::NONE)
    {
      break;
    }
    // Where a descent is believed, or two have met, no further one is needed from nearby.
    const bool settled = found.answer.doubt.empty() || met;
    if (settled && apart(place.poses, found.answer.poses) < distinct)
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
    rival = rival || settled;
    const bool there = apart(end.poses, found.answer.poses) < kMet;
    if (end.similarity > found.answer.similarity)
    {
      found.answer = end;
      similarity = search.similarity(end.poses);
      met = there;
    }
    met = met || there;
    ends.push_back(std::move(end));
  }
  std::sort(ends.begin(), ends.end(), [](const Outcome& a, const Outcome& b) { return a.similarity > b.similarity; });
  for (const Outcome& end : ends)
  {
    const bool own =
        end.views.empty() || apart(end.poses, found.answer.poses) < distinct ||
        std::any_of(found.rivals.begin(), found.rivals.end(),
                    [&](const Rival& rival) {
                      return targetRegistrationError(rival.room_from_patient, end.poses.target, target_box) < distinct;
                    });
    if (!own)
    {
      found.rivals.push_back({ end.poses.target, apart(end.poses, found.answer.poses),
                               rotationAngle(found.answer.poses.target.inverse() * end.poses.target), end.similarity });
    }
  }
  if (found.answer.doubt.empty() && !found.rivals.empty() &&
      found.rivals.front().similarity > kAsGood * found.answer.similarity)
  {
    const Rival& rival = found.rivals.front();
    found.answer.doubt = message("a place ", rival.distance_mm, " mm and ", rival.rotation_rad,
                                 " rad away is as similar: ", rival.similarity, ", here ", found.answer.similarity);
  }
  return found;
}
}  // namespace xray_tracking
