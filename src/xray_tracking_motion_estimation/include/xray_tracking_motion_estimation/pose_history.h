#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

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

  struct Entry
  {
    std::int64_t stamp;  ///< exposure time [ns]
    RigidTransform room_from_patient;
    bool registered;  ///< or corrected by a registration; otherwise tracked, from the last registered one on
  };

  void add(const Entry& entry) { poses_.push_back(entry); }

  /// The exposure of exactly this stamp, if its pose is known.
  std::optional<Entry> at(std::int64_t stamp) const
  {
    // The latest first: templates are trained on recent exposures, and what was added last is known best.
    const auto entry =
        std::find_if(poses_.rbegin(), poses_.rend(), [&](const Entry& pose) { return pose.stamp == stamp; });
    return entry == poses_.rend() ? std::nullopt : std::make_optional(*entry);
  }

  /// Replaces every tracked pose by what `correct(pose)` makes of it, once: what is found later is of what was tracked
  /// later.
  template <typename Function>
  void correctTracked(const Function& correct)
  {
    for (Entry& entry : poses_)
    {
      if (!entry.registered)
      {
        entry.room_from_patient = correct(entry.room_from_patient);
        entry.registered = true;
      }
    }
  }

  void forgetTracked()
  {
    poses_.erase(std::remove_if(poses_.begin(), poses_.end(), [](const Entry& entry) { return !entry.registered; }),
                 poses_.end());
  }

private:
  boost::circular_buffer<Entry> poses_;
};
}  // namespace xray_tracking
