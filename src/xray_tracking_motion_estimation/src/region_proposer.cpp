#include "xray_tracking_motion_estimation/region_proposer.h"

namespace xray_tracking
{
namespace
{
constexpr int kAstrayExposures = 2;              ///< in a row, before a region is learnt anew
constexpr std::int64_t kProposals = 1000000000;  ///< between two proposals for a view [ns]
constexpr double kAstray = 1.0;                  ///< from where a registration sees the target [mm]
}  // namespace

RegionProposer::RegionProposer(std::size_t views, const Eigen::Vector3d& target_centre)
  : target_centre_(target_centre), astray_(views)
{
}

void RegionProposer::look(const TrackedExposure& exposure, const ExposureEstimate& estimate,
                          const Refinement* refinement, const ExposureEstimator& tracks)
{
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    Astray& astray = astray_[i];
    std::optional<cv::Rect> region;
    if (view && !view->region.empty() && refinement != nullptr)
    {
      region = tracks.regionAt(i, refinement->refined);
    }
    const bool lost = view && view->state == RegionState::LOST;
    const bool other = region && followsOther(*view, tracks.geometries()[i], *region, refinement->refined);
    // Where all views follow the same wrong thing they agree; then it has taken more than two exposures to outvote
    // them.
    const bool outvoted = other && refinement->outvoted;
    const bool elsewhere = other && estimate.state == MotionState::INCONSISTENT;
    astray.exposures = outvoted ? kAstrayExposures : lost || elsewhere ? astray.exposures + 1 : 0;
    if (region && astray.exposures >= kAstrayExposures &&
        (!astray.proposed || exposure.stamp - *astray.proposed >= kProposals))
    {
      const Eigen::Vector2i& size = tracks.geometries()[i].imageSize();
      const cv::Rect inside = *region & cv::Rect(0, 0, size.x(), size.y());
      if (2 * inside.area() > region->area())
      {
        astray.proposed = exposure.stamp;
        proposals_.push_back({ i, inside });
      }
    }
  }
}

bool RegionProposer::followsOther(const TrackedView& tracked, const ProjectionGeometry& geometry,
                                  const cv::Rect& region, const RigidTransform& room_from_patient) const
{
  if (tracked.state != RegionState::TRACKING && tracked.state != RegionState::DEGRADED)
  {
    return false;
  }
  const cv::Point shift = region.tl() - tracked.region.tl();
  const double pixels = (Eigen::Vector2d(shift.x, shift.y) - tracked.track.displacement).norm();
  const Eigen::Vector3d target = room_from_patient * target_centre_;
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
