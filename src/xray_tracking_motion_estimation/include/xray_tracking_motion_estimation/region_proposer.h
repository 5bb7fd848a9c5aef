#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core/types.hpp>

#include "xray_tracking_motion_estimation/exposure_estimator.h"

namespace xray_tracking
{
/// A view whose region is to be learnt anew.
struct RegionProposal
{
  std::size_t view;
  cv::Rect region;  ///< where the target is seen now, as far as it is in the image [px]
};

/// Finds views that have lost the target, or follow something else, in exposures that are registered, and those whose
/// regions were placed by a pose that was none, or learnt while something hid the target: they are to learn their
/// regions anew where the target is, and while they show it. No clock.
class RegionProposer
{
public:
  /// @param target_box patient frame [mm]
  RegionProposer(std::size_t views, const Eigen::AlignedBox3d& target_box);

  /// The next exposure. @param estimate of its tracks, by `tracks`; @param refinement of it; null: it has none
  void look(const TrackedExposure& exposure, const ExposureEstimate& estimate, const Refinement* refinement,
            const ExposureEstimator& tracks);

  /// Somebody has stated that the patient is elsewhere, and a registration of that exposure [ns] has confirmed it: what
  /// was learnt until then was learnt where a wrong pose had put the target.
  void stated(std::int64_t stamp);
  /// As another's was, of what was stated; one a view.
  void takeUp(const std::vector<ViewSight>& sights);
  /// Stamp of the statement after which a view has yet to learn its region [ns]; nothing if it need not.
  std::optional<std::int64_t> statedFor(std::size_t view) const { return astray_[view].stated; }
  /// Whether there are views that have yet to learn where such a pose puts the target.
  bool learning() const;
  /// The next exposure after that: a view whose region does not cover the target's box, or was learnt while something
  /// hid the target, is to learn the box, once a second, until it has learnt what it may, and at which pose is known.
  /// @param pose the last one that is known, and its stamp [ns]; one that is older than a second places nothing
  void place(const TrackedExposure& exposure, const std::pair<std::int64_t, RigidTransform>& pose,
             const ExposureEstimator& tracks);

  /// What has come out; to be taken until there is none.
  std::optional<RegionProposal> take();

  void restart();

private:
  /// Of a view that does not follow the target.
  struct Astray
  {
    int exposures = 0;                       ///< in a row
    std::optional<std::int64_t> proposed{};  ///< stamp of the last proposal
    std::optional<std::int64_t> stated{};    ///< templates of no later stamp are to be learnt anew
  };
  void propose(std::size_t view, const cv::Rect& region, std::int64_t stamp);
  /// Whether a view's track is far from where the registration sees the target. @param region its, there [px]
  bool followsOther(const TrackedView& tracked, const ProjectionGeometry& geometry, const cv::Rect& region,
                    const RigidTransform& room_from_patient) const;

  Eigen::AlignedBox3d target_box_;
  std::vector<Astray> astray_;
  std::deque<RegionProposal> proposals_;
};
}  // namespace xray_tracking
