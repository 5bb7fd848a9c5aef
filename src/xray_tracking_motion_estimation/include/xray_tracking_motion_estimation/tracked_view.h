#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core/types.hpp>

#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// What became of a view's region in an exposure; values as in xray_tracking_msgs/TrackedRegion.
enum class RegionState : std::uint8_t
{
  UNTRAINED = 0,
  TRAINING = 1,
  TRACKING = 2,
  LOST = 3,
  DEGRADED = 4,
  BLIND = 5
};

/// How one view's region was tracked in an exposure.
struct TrackedView
{
  RegionState state = RegionState::UNTRAINED;
  std::string fault;                 ///< in words, why there is no track; empty where there is
  Track track;                       ///< valid if TRACKING or DEGRADED
  cv::Rect region;                   ///< the template's, in its own exposure [px]; empty without a template
  std::int64_t reference_stamp = 0;  ///< exposure that the template was trained on [ns]
  std::int64_t offset = 0;           ///< of the view's stamp from the exposure's [ns]
};

/// Why an exposure has no pose; values as in xray_tracking_msgs/PatientMotion.
enum class MotionState : std::uint8_t
{
  OK = 0,
  WAITING = 1,       ///< a view is untrained or training, or its geometry is missing or of no use
  LOST = 2,          ///< fewer than two views are left
  INCONSISTENT = 3,  ///< the views, or tracks and registration, contradict each other
  NO_REFERENCE = 4,  ///< a view was trained on an exposure whose pose is not known
  BAD_STAMP = 5,     ///< stamped in the future
  UNREGISTERED = 6   ///< only registered poses are published, and this exposure has none
};

/// As in the enumeration.
const char* motionStateName(MotionState state);

/// A complete exposure.
struct TrackedExposure
{
  std::int64_t stamp = 0;                         ///< [ns]
  std::int64_t arrival = 0;                       ///< monotonic clock [ns]
  std::int64_t age = 0;                           ///< at its arrival, by the clock that stamps are of [ns]
  MotionState fault = MotionState::OK;            ///< BAD_STAMP or WAITING if it is of no use, whatever the views say
  std::string text;                               ///< why
  std::vector<std::optional<TrackedView>> views;  ///< nothing of a view that was not waited for
  double cpu_seconds = 0.0;                       ///< processor time of all trackers
  double wall_seconds = 0.0;                      ///< from the images' arrival to that of the last track
};
}  // namespace xray_tracking
