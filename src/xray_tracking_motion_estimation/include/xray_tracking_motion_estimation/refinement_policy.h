#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include <Eigen/Core>
#include <boost/circular_buffer.hpp>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/pose_covariance.h"

namespace xray_tracking
{
/// When the registration of the X-ray images with the CT is asked for.
enum class RefinementMode
{
  NEVER,
  EVERY_FRAME,  ///< every exposure, in order, as far as `queue_size` reaches
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

  /// EVERY_FRAME: exposures that wait while a request is under way, >= 1; the oldest gives way. With 1 what is refined
  /// is the latest exposure; more is for those who want all of them.
  int queue_size = 1;

  // Thresholds of ON_DRIFT, each > 0.
  double drift = 3.0;            ///< of the target's centre since the last refinement [mm]
  double drift_rotation = 0.02;  ///< of the target since then [rad]
  double drift_residual = 0.4;   ///< the views' disagreement at the target [mm]

  /// A request that is not answered for so long is given up [s], > 0; ON_DRIFT waits so long after a refusal, too.
  double timeout = 2.0;

  // What a correction must not exceed, each > 0.
  double max_correction = 5.0;            ///< of the target's centre [mm]
  double max_correction_rotation = 0.07;  ///< [rad]

  /// Similarity that a refinement must reach, in the units of the registration's measure, which is to grow with the
  /// match. The seed's is a bound anyway.
  double min_similarity = 0.0;

  /// Probability that a good refinement is refused because it seems to contradict the tracked pose, in (0, 1).
  double significance = 0.001;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// An exposure and what tracking knows of its pose.
struct TrackedExposure
{
  std::int64_t stamp;                ///< [ns]
  RigidTransform room_from_patient;  ///< the last one known, if it is not measured
  PoseCovariance covariance;
  double disagreement;   ///< RMS over the views, at the target [mm]
  bool measured = true;  ///< false: the views contradict each other, or have lost their regions
};

struct RefinementRequest
{
  std::uint64_t id;
  std::int64_t stamp;                ///< exposure that is to be registered [ns]
  RigidTransform room_from_patient;  ///< where to start
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
};

/// An accepted refinement: that exposure's pose as it was tracked, if it was, and as it is.
struct Refinement
{
  std::int64_t stamp;
  std::optional<RigidTransform> tracked;
  RigidTransform refined;
  PoseCovariance covariance;  ///< of `refined`

  /// What an exposure's tracked pose becomes: the tracked motion of the target since the refined exposure (or from then
  /// back), applied where the target is after all; only if `tracked` is known. For tracks that measure translations
  /// only, multiplying poses by refined * tracked^-1 instead would turn these translations.
  RigidTransform carry(const RigidTransform& tracked_then, const Eigen::Vector3d& target_centre) const;
};

/// Asks for refinements and judges what comes back; eq. (8)'s reference is then moved by the caller, see
/// Refinement::carry(). A measured pose is checked against the answer; where there is none, the registration's own
/// judgement has to do. One request at a time. Never blocks; all methods from one thread.
class RefinementPolicy
{
public:
  /// Sends a request on its way without waiting. @return false if that is not possible now
  using Request = std::function<bool(const RefinementRequest&)>;

  /// @param target_centre patient frame [mm]
  /// @throws std::invalid_argument for bad options
  RefinementPolicy(const RefinementPolicyOptions& options, const Eigen::Vector3d& target_centre, Request request);

  /// An exposure; asks if it is time to. @param now monotonic clock [ns]
  void onExposure(const TrackedExposure& exposure, std::int64_t now);

  /// Asks for what waits, if nothing is under way. @param now monotonic clock [ns]
  void next(std::int64_t now);

  /// Gives up a request that takes too long. @return true if it did
  bool tick(std::int64_t now);

  /// The next exposure is to be refined, as soon as no request is under way.
  /// @return false if the mode is NEVER
  bool demand();

  /// @return nothing if it is refused, lastRefusal() says why; answers to requests given up are ignored. What waits is
  /// to be asked for by next(), and starts from where the refinement puts it
  std::optional<Refinement> onReply(const RefinementReply& reply);

  /// Time starts again: a request under way and all earlier poses are void.
  void reset();

  bool pending() const { return pending_.has_value(); }
  const std::string& lastRefusal() const { return last_refusal_; }
  /// Whether that was of a pose that the registration believes and that is too far from the tracked one.
  bool lastRefusalContradicts() const { return last_refusal_contradicts_; }
  std::size_t requests() const { return requests_; }
  std::size_t accepted() const { return accepted_; }
  std::size_t refused() const { return refused_; }    ///< answers without success, or that did not pass the checks
  std::size_t timeouts() const { return timeouts_; }  ///< requests given up
  std::size_t unheard() const { return unheard_; }    ///< requests that could not be sent
  std::size_t skipped() const { return skipped_; }    ///< EVERY_FRAME: exposures that gave way to later ones

private:
  struct Pending
  {
    std::uint64_t id;
    std::int64_t asked;  ///< monotonic clock [ns]
    TrackedExposure exposure;
  };
  bool due(const TrackedExposure& exposure, std::int64_t now) const;
  /// What is wrong with an answer by itself; empty if nothing is.
  std::string fault(const RefinementReply& reply) const;
  /// How it contradicts the tracked pose; empty if it does not.
  std::string contradiction(const RefinementReply& reply, const TrackedExposure& exposure) const;

  RefinementPolicyOptions options_;
  Eigen::Vector3d target_centre_;
  Request request_;
  std::optional<Pending> pending_;
  boost::circular_buffer<TrackedExposure> waiting_;
  std::optional<RigidTransform> anchor_;  ///< tracked pose at the start or just refined: what drift is counted from
  std::uint64_t next_id_ = 1;
  int exposures_since_request_ = 0;
  bool demanded_ = false;
  std::int64_t not_before_ = 0;  ///< monotonic clock, ON_DRIFT [ns]
  std::string last_refusal_;
  bool last_refusal_contradicts_ = false;
  std::size_t requests_ = 0;
  std::size_t accepted_ = 0;
  std::size_t refused_ = 0;
  std::size_t timeouts_ = 0;
  std::size_t unheard_ = 0;
  std::size_t skipped_ = 0;
};
}  // namespace xray_tracking
