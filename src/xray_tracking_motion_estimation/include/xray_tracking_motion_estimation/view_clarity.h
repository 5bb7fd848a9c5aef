#pragma once

#include <optional>
#include <vector>

namespace xray_tracking
{
/// Figures of the views that a registration has compared, one a view. @param without the views that it was not to
/// compare
/// @return not finite for those; none if there are not as many figures as views that were to be compared
std::vector<double> oneAView(const std::vector<double>& compared, const std::vector<bool>& without);

/// Tells from what registrations say of their views whether a view shows the target: what passes in front of it, as an
/// instrument does, leaves the pose to the other views, and is not to be learnt for the target. No clock.
class ViewClarity
{
public:
  /// The views of an accepted registration. @param similarities one a view, -1 to 1; not finite: it was not compared;
  /// none at all where nothing is known of them
  /// @return whether each view's similarity is less than half of what it usually is; as many as were given
  std::vector<bool> hidden(const std::vector<double>& similarities);

  void restart() { usual_.clear(); }

private:
  std::vector<std::optional<double>> usual_;  ///< one a view; nothing of one that was never compared
};
}  // namespace xray_tracking
