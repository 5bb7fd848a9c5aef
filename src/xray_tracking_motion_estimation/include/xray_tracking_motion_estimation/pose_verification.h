#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace xray_tracking
{
struct PoseVerificationOptions
{
  /// Whether a registration is asked. It then has to confirm the pose, at the start and again and again.
  bool registration = false;

  /// Without a registration: somebody states that the patient is at the initial pose when the first templates are
  /// learnt. Holds until there is a doubt. With one it counts for nothing.
  bool initial_pose_verified = false;

  /// Tracks that no registration has confirmed for longer than both of these are not believed: tissue that moves
  /// otherwise than the target may hold them, with every figure of theirs at its best.
  /// [s], > 0. Within a breath, of 3 to 5 s, tissue has been to all the places that it goes to, and what turns by 3 to
  /// 6 degrees a second, unseen by tracks of shifts, was off by up to 2.2 mm after 1 s (knee_real, on which this was
  /// chosen).
  double max_unverified_time = 0.5;
  /// [exposure intervals], >= 1. For exposures that are seconds apart: one may be refused.
  double max_unverified_exposures = 3.0;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// Whether the poses that tracks lead to are verified. Tracks tell how the target moved, not where it was at first: the
/// initial pose is a claim. What verifies it is an accepted refinement: the registration believes a pose, and the
/// tracks, or the registrations before, agree with it. After one that was refused it takes two in a row: who asks often
/// enough about a wrong pose will be told once that it is right.
///
/// No clock of its own; stamps are those of exposures [ns].
class PoseVerification
{
public:
  /// @throws std::invalid_argument for bad options
  explicit PoseVerification(const PoseVerificationOptions& options);

  /// The initial pose is a claim again.
  void restart();

  /// Nothing is verified any more, until the next confirm().
  void doubt(const std::string& why);

  /// The latest exposure. @param interval between exposures [ns]
  void update(std::int64_t stamp, std::int64_t interval);

  /// An accepted refinement, of a later exposure than the one before.
  void confirm(std::int64_t stamp);

  /// What the registration found was not accepted, or it found nothing.
  /// @param contradicts it believes a pose which the tracks contradict: one of the two is wrong
  void refuse(const std::string& why, bool contradicts);

  /// Why the pose is not verified, with the registration's last word; empty if it is.
  std::string fault() const;
  bool verified() const { return doubt_.empty() && !lapsed(); }

  /// Whether it is time to ask a registration: nothing is verified, or half of the time that a verification holds is
  /// over.
  bool due() const;

private:
  /// From the last verified exposure to the latest [s].
  double age() const;
  double maxAge() const;
  bool lapsed() const { return confirmed_ && age() > maxAge(); }

  PoseVerificationOptions options_;
  std::string doubt_;                      ///< empty if there is none
  bool claimed_ = true;                    ///< nothing has happened yet but that the initial pose was claimed
  std::optional<std::int64_t> confirmed_;  ///< exposure of the last accepted refinement
  std::int64_t latest_ = 0;
  std::int64_t interval_ = 0;
  int refusals_ = 0;           ///< since then
  bool refused_last_ = false;  ///< and not accepted
  std::string last_refusal_;
};
}  // namespace xray_tracking
