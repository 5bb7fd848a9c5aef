#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace xray_tracking
{
/// What the stamp of the next message on a topic means, beside those before it and the clock: the one policy of all
/// that take exposures.
///
/// In whole nanoseconds: stamps that are farther apart than a ros::Duration can say (2^31 s) are nothing special.
class StampPolicy
{
public:
  enum class Verdict
  {
    ACCEPT,            ///< newer than all before it
    REPEATED_OR_LATE,  ///< not newer, by a second at most: a disorder; to be dropped
    FUTURE,            ///< more than a second ahead of the clock: to be dropped, else the next good one would look like
                       ///< another run
    RESTART  ///< more than a second before the last one, as of a bag that starts again: forget what was before
  };

  /// Stamps of another run, or of no time that has been, are off by more than this [ns].
  static constexpr std::int64_t kJump = 1000000000;

  /// Takes in the next stamp [ns, >= 0]. One that is to be dropped changes nothing for those after it.
  /// @param now_ns of the clock that stamps are of; 0 where it has not begun (simulated time): then none is ahead
  Verdict take(std::int64_t stamp_ns, std::int64_t now_ns);

  /// In words, the stamp, what it was compared with and what was expected, of the last one unless it was accepted.
  std::string why() const;

  /// The last stamp that was accepted or began another run.
  std::optional<std::int64_t> last() const { return last_; }
  void reset() { last_.reset(); }

private:
  std::optional<std::int64_t> last_;
  Verdict verdict_ = Verdict::ACCEPT;
  std::int64_t stamp_ = 0;     ///< that `verdict_` is of
  std::int64_t compared_ = 0;  ///< with the clock or the stamp before
};
}  // namespace xray_tracking
