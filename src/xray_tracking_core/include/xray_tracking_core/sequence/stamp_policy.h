#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace xray_tracking
{
/// What the stamp of the next message on a topic means, beside those before it and the clock: the one policy of all
/// that take exposures.
///
/// Not everybody can afford the same: who publishes poses wants stamps of the clock itself, and a restart that is sure.
/// In whole nanoseconds: stamps that are farther apart than a ros::Duration can say (2^31 s) are nothing special.
class StampPolicy
{
public:
  enum class Verdict
  {
    ACCEPT,            ///< newer than all before it
    REPEATED_OR_LATE,  ///< not newer, by a second at most: a disorder; to be dropped
    FUTURE,  ///< too far ahead of the clock: to be dropped, else the next good one would look like another run
    RESTART  ///< more than a second before the last one, as of a bag that starts again: forget what was before
  };

  /// Stamps of another run, or of no time that has been, are off by more than this [ns].
  static constexpr std::int64_t kJump = 1000000000;

  struct Options
  {
    std::int64_t max_ahead = kJump;  ///< how far stamps may be ahead of the clock [ns]
    /// For how long, by the clock, nothing but stamps of another run have to come, each later than the one before it,
    /// until it is a restart [ns]: till then they are late ones. It is one at once if by now the last stamp is of the
    /// future: then the clock has gone back. 0: always at once.
    std::int64_t restart_confirmed = 0;
  };

  StampPolicy() = default;
  explicit StampPolicy(const Options& options) : options_(options) {}

  /// Not newer than the last one, by a second at most.
  static bool isRepeatedOrLate(std::int64_t stamp_ns, std::int64_t last_ns)
  {
    return stamp_ns <= last_ns && last_ns - stamp_ns <= kJump;
  }

  /// Takes in the next stamp [ns, >= 0]. One that is to be dropped changes nothing for those after it.
  /// @param now_ns of the clock that stamps are of; 0 where it has not begun (simulated time): then none is ahead
  Verdict take(std::int64_t stamp_ns, std::int64_t now_ns);

  /// In words, the stamp, what it was compared with and what was expected, of the last one unless it was accepted.
  std::string why() const;

  /// The last stamp that was accepted or began another run.
  std::optional<std::int64_t> last() const { return last_; }
  void reset()
  {
    last_.reset();
    older_.reset();
  }

private:
  /// Stamps of another run that came since the last one.
  struct Older
  {
    std::int64_t stamp;  ///< of the latest one
    std::int64_t since;  ///< when the first one came
  };

  /// @param stamp more than a second before the last one
  bool isRestart(std::int64_t stamp, std::int64_t now);
  Verdict accept(std::int64_t stamp, Verdict verdict);

  Options options_;
  std::optional<std::int64_t> last_;
  std::optional<Older> older_;
  Verdict verdict_ = Verdict::ACCEPT;
  std::int64_t stamp_ = 0;     ///< that `verdict_` is of
  std::int64_t compared_ = 0;  ///< with the clock or the stamp before
};
}  // namespace xray_tracking
