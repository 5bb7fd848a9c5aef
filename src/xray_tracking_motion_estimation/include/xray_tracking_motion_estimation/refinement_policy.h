#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"

namespace xray_tracking
{
/// When the registration of the X-ray images with the CT is asked for.
enum class RefinementMode
{
  NEVER,
  EVERY_FRAME,  ///< every exposure
  EVERY_N,      ///< every n-th exposure
  ON_DEMAND,    ///< when somebody asks, which is possible in every mode but NEVER
  ON_DRIFT      ///< once the target moved, turned, or the views came apart by more than a threshold since the last one,
                ///< or there is no pose
};

/// @throws std::invalid_argument if `name` is none of never, every_frame, every_n, on_demand, on_drift
RefinementMode refinementModeFromName(const std::string& name);

struct RefinementPolicyOptions
{
  RefinementMode mode = RefinementMode::NEVER;
  int every_n = 30;  ///< exposures, >= 1

  // Thresholds of ON_DRIFT, each > 0.
  double drift = 3.0;            ///< of the target's centre since the last refinement [mm]
  double drift_rotation = 0.02;  ///< of the target since then [rad]
  double drift_residual = 0.4;   ///< the views' disagreement at the target [mm]

  /// A request that is not answered for so long is given up [s], > 0; ON_DRIFT waits so long after a refusal, too.
  double timeout = 2.0;

  // What a correction must not exceed, each > 0.
  double max_correction = 5.0;            ///< of the target's centre [mm]
  double max_correction_rotation = 0.07;  ///< [rad]

  /// Speed that the target's centre can have, >= 0 [mm/s]: by it and the time since the last pose the bound of the
  /// correction grows where there is no tracked pose, to twice its size at most, and by it two registrations of the
  /// same target may differ.
  double target_speed = 15.0;

  /// Similarity that a refinement must reach, in the units of the registration's measure, which is to grow with the
  /// match. The seed's is a bound anyway, but for noise.
  double min_similarity = 0.0;

  /// Probability that a good refinement is refused because it seems to contradict the tracked pose, in (0, 1).
  double significance = 0.001;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// An exposure and what is known of its pose before it is registered.
struct RefinementSeed
{
  std::int64_t stamp;                ///< [ns]
  RigidTransform room_from_patient;  ///< the last one known, if it is not tracked
  PoseCovariance covariance;
  double disagreement;  ///< RMS over the views, at the target [mm]
  bool tracked = true;  ///< false: the views contradict each other, or have lost their regions
  double since = 0.0;   ///< if it is not tracked: time since the last pose that tracks or a registration gave [s]
};

struct RefinementRequest
{
  std::uint64_t id;
  std::int64_t stamp;                ///< exposure that is to be registered [ns]
  RigidTransform room_from_patient;  ///< where to start
  bool unverified;                   ///< nothing has confirmed where to start
  std::vector<bool> without{};       ///< views whose images say nothing of the patient, if there are any
};

struct RefinementReply
{
  std::uint64_t id = 0;  ///< the request's
  bool success = false;
  std::string text;  ///< why not
  RigidTransform room_from_patient = RigidTransform::Identity();
  PoseCovariance covariance = PoseCovariance::Zero();
  double seed_similarity = 0.0;  ///< at the pose that the request started from
  double similarity = 0.0;       ///< at the refined pose
  double pull = 0.0;             ///< by how much a view alone would move the target, the largest [mm]
  /// At the refined pose, one a view; not finite of those without which it was asked; none if nothing is known of them.
  std::vector<double> view_similarities{};
};

/// An accepted refinement: that exposure's pose as it was tracked, if it was, and as it is.
struct Refinement
{
  std::int64_t stamp;
  std::optional<RigidTransform> tracked;
  RigidTransform refined;
  PoseCovariance covariance;  ///< of `refined`
  /// The tracks contradicted it, and registrations that agree with each other have outvoted them: what they follow is
  /// not the target.
  bool outvoted = false;
  /// Somebody has stated that the target is about there, whatever was known of it before.
  bool claimed = false;
  /// Views in which it does not see the target, see ViewClarity: one a view, or none.
  std::vector<bool> hidden{};

  /// What an exposure's tracked pose becomes: the tracked motion of the target since the refined exposure (or from then
  /// back), applied where the target is after all; only if `tracked` is known. For tracks that measure translations
  /// only, multiplying poses by refined * tracked^-1 instead would turn these translations.
  RigidTransform carry(const RigidTransform& tracked_then, const Eigen::Vector3d& target_centre) const;
};

/// What an answer came to.
enum class RefinementVerdict
{
  ACCEPTED,
  REFUSED,      ///< the registration has failed, or is not believed, or its numbers are of no use
  CONTRADICTS,  ///< it believes a pose that the tracked one contradicts, or its views each other: one of them is wrong
  UNCONFIRMED   ///< it believes a pose, and there is no tracked one: the next exposure's has to agree with it
};

/// Says when to ask for refinements and judges what comes back. One request at a time; all methods from one thread.
///
/// A believed pose is accepted if its views agree, and it with the tracked one, by bounds and by chi-square, and is no
/// leap that the tracks have not seen. Registrations that agree with each other, by the way that the target can have
/// gone meanwhile, outweigh tracks: three in a row those that are off by more than chi-square allows, if exposures are
/// so dense that this way is less than the bound; three in a row that contradict them or leap those that are off by up
/// to twice the bound; two in a row those that have lost the target, up to the bound and the way that the target can
/// have gone since the last pose, twice the bound at most. So nobody gets to the next vertebra, which is 18 mm away or
/// more, however long nothing was seen.
class RefinementPolicy
{
public:
  /// @param target_centre patient frame [mm]
  /// @throws std::invalid_argument for bad options
  RefinementPolicy(const RefinementPolicyOptions& options, const Eigen::Vector3d& target_centre);

  /// Whether the next exposure is to be refined; to be called once for each. @param now monotonic clock [ns]
  bool due(const RefinementSeed& exposure, std::int64_t now);

  /// The request for an exposure, which is under way from here on. Where nothing is tracked and the last registration
  /// waits to be confirmed, it starts from that one's pose. Where nothing has confirmed the tracks for long, and three
  /// registrations in a row from where they lead were not believed, every other one starts from the last accepted pose:
  /// tracks may follow something else. @throws std::logic_error if there is one under way
  RefinementRequest ask(const RefinementSeed& exposure, bool unverified, std::int64_t now);

  /// The same from a pose that somebody states, see MotionMonitor::claim(). Its answer has to be believed, its views
  /// to agree, and it to be within the bounds of a correction of that pose; what tracks say counts for nothing, and a
  /// refusal changes nothing.
  RefinementRequest askClaimed(std::int64_t stamp, const RigidTransform& room_from_patient, std::int64_t now);

  /// Gives up the request under way, if there is one.
  void giveUp() { pending_.reset(); }

  /// Gives up a request that takes too long. @return true if it did
  bool tick(std::int64_t now);

  /// The next exposure is to be refined, as soon as no request is under way.
  /// @return false if the mode is NEVER
  bool demand();

  struct Judgement
  {
    RefinementVerdict verdict;
    std::string reason;                    ///< empty if it is accepted
    std::optional<Refinement> refinement;  ///< if it is
  };
  /// Of the answer to the request under way. @throws std::logic_error if it is to none
  Judgement judge(const RefinementReply& reply);

  /// Time starts again: a request under way and all earlier poses are void.
  void reset();

  /// The request under way; nothing if there is none.
  std::optional<std::uint64_t> pending() const { return pending_ ? std::optional(pending_->id) : std::nullopt; }
  const RefinementPolicyOptions& options() const { return options_; }
  const std::string& lastRefusal() const { return last_refusal_; }
  std::size_t requests() const { return requests_; }
  std::size_t accepted() const { return accepted_; }
  std::size_t refused() const { return refused_; }    ///< answers that were not accepted
  std::size_t timeouts() const { return timeouts_; }  ///< requests given up

private:
  struct Pending
  {
    std::uint64_t id;
    std::int64_t asked;  ///< monotonic clock [ns]
    RefinementSeed exposure;
    bool claimed = false;
    bool where_it_was = false;  ///< it starts from the last accepted pose, whatever tracks say
  };
  /// Believed registrations that agree with each other, one exposure after another.
  struct Chain
  {
    std::int64_t stamp;  ///< of the last one [ns]
    RigidTransform refined;
    PoseCovariance covariance;
    int length;
    int dense;    ///< the last ones of them between which the target cannot have gone far
    int against;  ///< the last ones of them that contradict the tracks
  };
  struct Accepted
  {
    std::int64_t stamp;  ///< [ns]
    RigidTransform refined;
    PoseCovariance covariance;
  };
  /// What is wrong with an answer by itself; empty if nothing is.
  std::string fault(const RefinementReply& reply) const;
  /// How it is out of the bounds of a correction; empty if it is not. @param factor on the bounds
  std::string excess(const RefinementReply& reply, const RefinementSeed& exposure, double factor) const;
  /// How it contradicts the tracked pose within the bounds; empty if it does not.
  std::string contradiction(const RefinementReply& reply, const RefinementSeed& exposure) const;
  /// How it is farther from the tracked pose, which counts from the accepted one before, than tissue and the two
  /// registrations' spread account for in the time between: the tracks have not seen such a motion, or have alone.
  /// Empty if it is not.
  std::string leap(const RefinementReply& reply, const RefinementSeed& exposure) const;
  /// Standard deviation of the target's way from one pose to the other in its worst direction [mm].
  double worstSigma(const RigidTransform& one, const PoseCovariance& its_covariance, const RigidTransform& other,
                    const PoseCovariance& other_covariance) const;
  void extendChain(const RefinementReply& reply, std::int64_t stamp);
  Judgement judgeClaimed(const RefinementReply& reply, const RefinementSeed& claim);

  RefinementPolicyOptions options_;
  Eigen::Vector3d target_centre_;
  std::optional<Pending> pending_;
  std::optional<Chain> chain_;
  std::optional<Accepted> last_accepted_;
  std::optional<RigidTransform> anchor_;  ///< tracked pose at the start or just refined: what drift is counted from
  std::uint64_t next_id_ = 1;
  int exposures_since_request_ = 0;
  /// Registrations in a row that were not believed, or of no use.
  int unbelieved_ = 0;
  bool demanded_ = false;
  std::int64_t not_before_ = 0;  ///< monotonic clock, ON_DRIFT [ns]
  std::string last_refusal_;
  std::size_t requests_ = 0;
  std::size_t accepted_ = 0;
  std::size_t refused_ = 0;
  std::size_t timeouts_ = 0;
};
}  // namespace xray_tracking
