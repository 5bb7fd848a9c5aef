#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace xray_tracking
{
/// Figures of the detectors that a registration has compared, in the order of some views.
/// @return not finite for views that were not compared; none if there are not as many figures as detectors compared
std::vector<double> ofViews(const std::vector<double>& figures, const std::vector<std::string>& compared,
                            const std::vector<std::string>& views);

/// What accepted registrations have seen of the target in a view.
struct ViewSight
{
  std::optional<double> usual{};  ///< its similarity, usually; nothing if it was never compared
  bool hidden = false;            ///< it did not show the target when it was last compared
  /// The latest template that was compared by an accepted registration [ns], and whether the first such did not see the
  /// target.
  std::optional<std::int64_t> template_stamp{};
  bool template_hidden = false;
  /// Templates of no later stamp are to be learnt anew, see RegionProposer::stated() [ns]; nothing if none is.
  std::optional<std::int64_t> stated{};
};

/// Tells from what registrations say of their views whether a view shows the target: what passes in front of it, as an
/// instrument does, leaves the pose to the other views, and is not to be learnt for the target. No clock.
class ViewClarity
{
public:
  /// The views of an accepted registration. @param similarities one a view; not of -1 to 1: it was not compared; none
  /// at all where nothing is known of them; @param stamp of its exposure [ns]
  /// @return whether each view's similarity was less than half of what it usually is when it was last compared; one a
  /// view, or none so far
  const std::vector<bool>& hidden(const std::vector<double>& similarities, std::int64_t stamp);

  /// As another's was: what is usual and what is hidden, one a view. @param stamp of its last exposure [ns]
  void takeUp(const std::vector<ViewSight>& sights, std::int64_t stamp);
  /// What is usual, one a view; none so far.
  const std::vector<std::optional<double>>& usual() const { return usual_; }

  /// Neither what is usual nor what is hidden is known any more.
  void restart();

private:
  std::vector<std::optional<double>> usual_;  ///< one a view; nothing of one that was never compared
  std::vector<bool> hidden_;
  std::optional<std::int64_t> last_stamp_;
};
}  // namespace xray_tracking
