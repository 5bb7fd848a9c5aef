#include "xray_tracking_motion_estimation/region_proposer.h"

#include <algorithm>

#include "xray_tracking_core/geometry/projected_box.h"

namespace xray_tracking
{
namespace
{
constexpr int kAstrayExposures = 2;              ///< in a row, before a region is learnt anew
constexpr std::int64_t kProposals = 1000000000;  ///< between two proposals for a view [ns]
constexpr double kAstray = 1.0;                  ///< from where a registration sees the target [mm]
constexpr std::int64_t kFresh = 1000000000;      ///< age up to which a pose says where to look [ns]

/// Whether two regions have more than half of what either covers in common: a region that somebody has drawn around the
/// target is that good, and one that is off by half of its width is not.
bool coverTheSame(const cv::Rect& a, const cv::Rect& b)
{
  const int common = (a & b).area();
  return 2 * common > a.area() + b.area() - common;
}

bool isFound(const TrackedView& view)
{
  return view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED;
}
}  // namespace

RegionProposer::RegionProposer(std::size_t views, const Eigen::AlignedBox3d& target_box)
  : target_box_(target_box), astray_(views)
{
}

void RegionProposer::look(const TrackedExposure& exposure, const ExposureEstimate& estimate,
                          const Refinement* refinement, const ExposureEstimator& tracks)
{
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    Astray& astray = astray_[i];
    if (astray.stated)
    {
      continue;
    }
    std::optional<cv::Rect> region;
    bool spoilt = false;
    if (view && !view->region.empty() && refinement != nullptr)
    {
      region = tracks.regionAt(i, refinement->refined);
      spoilt = tracks.isSpoilt(i, *view);
      if (spoilt && !region)  // no template before it is known
      {
        region = projectedBoxRegion(target_box_, refinement->refined, tracks.geometries()[i]);
      }
    }
    const bool lost = view && view->state == RegionState::LOST;
    const bool other = region && followsOther(*view, tracks.geometries()[i], *region, refinement->refined);
    // Where all views follow the same wrong thing they agree; then it has taken more than two exposures to outvote
    // them.
    const bool outvoted = other && refinement->outvoted;
    const bool unplaced = region && tracks.templateStamp(i) != view->reference_stamp;
    const bool elsewhere = other && (estimate.state == MotionState::INCONSISTENT || unplaced);
    // What hides the target now is not to be learnt.
    astray.exposures = tracks.isHidden(i)            ? 0
                       : outvoted                    ? kAstrayExposures
                       : lost || elsewhere || spoilt ? astray.exposures + 1
                                                     : 0;
    if (region && astray.exposures >= kAstrayExposures)
    {
      const Eigen::Vector2i& size = tracks.geometries()[i].imageSize();
      const cv::Rect inside = *region & cv::Rect(0, 0, size.x(), size.y());
      if (2 * inside.area() > region->area())
      {
        propose(i, inside, exposure.stamp);
      }
    }
  }
}

void RegionProposer::stated(std::int64_t stamp)
{
  for (Astray& astray : astray_)
  {
    astray.stated = stamp;
  }
}

void RegionProposer::takeUp(const std::vector<ViewSight>& sights)
{
  restart();
  for (std::size_t i = 0; i < astray_.size(); ++i)
  {
    astray_[i].stated = sights.at(i).stated;
  }
}

bool RegionProposer::learning() const
{
  return std::any_of(astray_.begin(), astray_.end(), [](const Astray& astray) { return astray.stated.has_value(); });
}

void RegionProposer::place(const TrackedExposure& exposure, const std::pair<std::int64_t, RigidTransform>& pose,
                           const ExposureEstimator& tracks)
{
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    std::optional<std::int64_t>& stated = astray_[i].stated;
    if (!stated || !view || tracks.isHidden(i) || exposure.stamp - pose.first > kFresh)
    {
      continue;
    }
    const cv::Rect box = projectedBoxRegion(target_box_, pose.second, tracks.geometries()[i]);
    const cv::Point moved(cvRound(view->track.displacement.x()), cvRound(view->track.displacement.y()));
    const bool covers = isFound(*view) && coverTheSame(view->region + moved, box);
    const std::optional<std::int64_t> learnt = tracks.templateStamp(i);
    if (learnt && (*learnt > *stated || covers))
    {
      stated.reset();
    }
    else if (!box.empty() && (tracks.isSpoilt(i, *view) || (!covers && view->reference_stamp <= *stated)))
    {
      propose(i, box, exposure.stamp);
    }
  }
}

void RegionProposer::propose(std::size_t view, const cv::Rect& region, std::int64_t stamp)
{
  std::optional<std::int64_t>& last = astray_[view].proposed;
  if (!last || stamp - *last >= kProposals)
  {
    last = stamp;
    proposals_.push_back({ view, region });
  }
}

bool RegionProposer::followsOther(const TrackedView& tracked, const ProjectionGeometry& geometry,
                                  const cv::Rect& region, const RigidTransform& room_from_patient) const
{
  if (!isFound(tracked))
  {
    return false;
  }
  const cv::Point shift = region.tl() - tracked.region.tl();
  const double pixels = (Eigen::Vector2d(shift.x, shift.y) - tracked.track.displacement).norm();
  const Eigen::Vector3d target = room_from_patient * target_box_.center();
  return pixels * geometry.pixelPitch().mean() > kAstray * geometry.magnification(target);
}

std::optional<RegionProposal> RegionProposer::take()
{
  if (proposals_.empty())
  {
    return std::nullopt;
  }
  const RegionProposal proposal = proposals_.front();
  proposals_.pop_front();
  return proposal;
}

void RegionProposer::restart()
{
  astray_.assign(astray_.size(), {});
  proposals_.clear();
}
}  // namespace xray_tracking
