#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <utility>

#include <boost/circular_buffer.hpp>

#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// The patient's pose at the latest exposures: what a template that was trained on one of them is relative to.
class PoseHistory
{
public:
  /// @param capacity number of exposures kept, 1 or more; the oldest addition goes first
  explicit PoseHistory(std::size_t capacity) : poses_(capacity) {}

  bool empty() const { return poses_.empty(); }
  void clear() { poses_.clear(); }

  /// @param stamp exposure time [ns]
  void add(std::int64_t stamp, const RigidTransform& room_from_patient)
  {
    poses_.push_back({ stamp, room_from_patient });
  }

  /// room_from_patient at the exposure of exactly this stamp, if it is known.
  std::optional<RigidTransform> at(std::int64_t stamp) const
  {
    // The latest first: templates are trained on recent exposures.
    const auto entry =
        std::find_if(poses_.rbegin(), poses_.rend(), [&](const auto& pose) { return pose.first == stamp; });
    return entry == poses_.rend() ? std::nullopt : std::make_optional(entry->second);
  }

  /// Replaces every pose by what `correct(pose)` makes of it.
  template <typename Function>
  void transform(const Function& correct)
  {
    for (auto& entry : poses_)
    {
      entry.second = correct(entry.second);
    }
  }

private:
  boost::circular_buffer<std::pair<std::int64_t, RigidTransform>> poses_;
};
}  // namespace xray_tracking
