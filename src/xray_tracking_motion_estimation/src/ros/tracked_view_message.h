#pragma once

#include <cstdint>

#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
/// A state or model that is none makes a view that is lost. @param offset of its stamp from the exposure's [ns]
TrackedView trackedViewFromMsg(const xray_tracking_msgs::TrackedRegion& region, std::int64_t offset);
}  // namespace xray_tracking
