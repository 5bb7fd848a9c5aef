#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include <Eigen/Core>
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

/// Finds views that have lost the target, or follow something else, in exposures that are registered: they are to learn
/// their regions anew where the registration sees the target. No clock.
class RegionProposer
{
public:
  /// @param target_centre patient frame [mm]
  RegionProposer(std::size_t views, const Eigen::Vector3d& target_centre);

  /// The next exposure. @param estimate of its tracks, by `tracks`; @param refinement of it; null: it has none
  void look(const TrackedExposure& exposure, const ExposureEstimate& estimate, const Refinement* refinement,
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
  };
  /// Whether a view's track is far from where the registration sees the target. @param region its, there [px]
  bool followsOther(const TrackedView& tracked, const ProjectionGeometry& geometry, const cv::Rect& region,
                    const RigidTransform& room_from_patient) const;

  Eigen::Vector3d target_centre_;
  std::vector<Astray> astray_;
  std::deque<RegionProposal> proposals_;
};
}  // namespace xray_tracking
