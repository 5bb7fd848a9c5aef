#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace xray_tracking
{
struct BeamHoldOptions
{
  /// Silence of an operator's panel that holds the beam, once one has been heard [s], > 0.
  double operator_silence = 1.0;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// The beam held by people: an operator who says so, or whose panel is lost. Latched: nothing but a release ends it, no
/// good exposure and no new start.
///
/// Panels say by a heartbeat that they are there; any one counts. While none has ever been heard none is missed.
class BeamHold
{
public:
  /// @throws std::invalid_argument for bad options
  explicit BeamHold(const BeamHoldOptions& options);

  void hold(const std::string& why);
  /// @param now monotonic clock [ns]
  /// @return why it goes on: a panel that was heard is still silent; empty if the beam is held no more
  std::string release(std::int64_t now);
  /// An operator's panel was heard. @param now monotonic clock [ns]
  void operatorPresent(std::int64_t now);
  /// To be called often. @param now monotonic clock [ns]
  void tick(std::int64_t now);

  /// Whether an operator's panel was ever heard.
  bool operatorHeard() const { return heard_.has_value(); }
  /// As it was before a restart. @param why empty: not held; @param heard whether an operator's panel was: it has to
  /// come again; @param now monotonic clock [ns]
  void takeUp(const std::string& why, bool heard, std::int64_t now);

  bool held() const { return !why_.empty(); }
  const std::string& why() const { return why_; }  ///< for people; empty if it is not held

private:
  bool silent(std::int64_t now) const;

  BeamHoldOptions options_;
  std::string why_;
  std::optional<std::int64_t> heard_;
};
}  // namespace xray_tracking
