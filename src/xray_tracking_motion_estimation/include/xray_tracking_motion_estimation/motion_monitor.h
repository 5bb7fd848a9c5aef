#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_motion_estimation/beam_gate.h"
#include "xray_tracking_motion_estimation/exposure_estimator.h"
#include "xray_tracking_motion_estimation/motion_decision.h"
#include "xray_tracking_motion_estimation/motion_monitor_options.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"
#include "xray_tracking_motion_estimation/region_proposer.h"
#include "xray_tracking_motion_estimation/tracked_view.h"
#include "xray_tracking_motion_estimation/view_clarity.h"

namespace xray_tracking
{
/// What became of a pose that somebody stated.
struct ClaimOutcome
{
  std::string refusal;                                            ///< why it is not accepted; empty if it is
  std::int64_t stamp = 0;                                         ///< of the exposure that was registered [ns]
  RigidTransform room_from_patient = RigidTransform::Identity();  ///< the registered pose, if it is accepted
};

/// What is known of the patient's pose, without ROS and without a clock of its own: exposures, answers of the
/// registration and the time come in, decisions go out. Each exposure gets one decision, in the order in which they
/// came: at once, or, where the method wants a registered pose, when its registration has been answered or its deadline
/// is over. All that is published of poses is decided here, live and offline alike.
///
/// Deterministic: the same events give the same decisions. Not thread safe.
class MotionMonitor
{
public:
  /// @param room_from_patient the setup's initial pose; @param target_box patient frame [mm]
  /// @throws std::invalid_argument for bad options
  MotionMonitor(const MotionMonitorOptions& options, const RigidTransform& room_from_patient,
                const Eigen::AlignedBox3d& target_box);

  /// The tracks' side: its geometry has to be set before the first exposure that is of use.
  ExposureEstimator& tracks() { return tracks_; }
  const ExposureEstimator& tracks() const { return tracks_; }

  /// A complete exposure. @param now monotonic clock [ns]
  void onExposure(TrackedExposure exposure, std::int64_t now);
  /// An answer to a request; one that was given up counts for nothing. @param now monotonic clock [ns]
  void onReply(const RefinementReply& reply, std::int64_t now);
  /// To be called often, and at wakeAt(). @param now monotonic clock [ns]
  void onTime(std::int64_t now);
  /// The monotonic time at which something has to be decided, if nothing comes before [ns]; nothing if nothing waits.
  std::optional<std::int64_t> wakeAt() const;

  /// Time starts again: all but the geometry and what templates were learnt of is forgotten, and what waits.
  /// @param doubt why the patient may be elsewhere than at the initial pose: no pose until a refinement confirms one;
  /// empty if it is taken to be there
  void restart(const std::string& doubt);

  /// What to go on with in another process if this one dies; nothing if no pose is known.
  std::optional<MotionMemory> memory() const;

  /// Goes on from what another one knew when it died. With the geometry, the same one, before the first exposure.
  /// Where a registration is asked nothing of it is verified, and no pose comes, but of method tracking, before one is
  /// accepted; without a registration the memory's own doubt, if there is one, goes on. What the target did meanwhile
  /// is a jump to the gate.
  /// @throws std::invalid_argument if it cannot be, whereupon nothing is changed
  void takeUp(const MotionMemory& memory);

  /// The next exposure is to be refined. @return false if registrations are never asked for
  bool demandRefinement() { return refinement_.demand(); }

  /// Somebody states where the patient is. That is a claim, as the initial pose is one: the latest exposure is
  /// registered from there as soon as the registration is free. If that is believed, its views agree, and it is within
  /// the bounds of a correction, motion counts from the registered pose, and all that was known before is void,
  /// whatever tracks have said; else nothing changes. Views whose regions are not over the target there are to learn
  /// them anew, and until they have, exposures are registered whatever the mode. After a refused claim it takes two
  /// registrations in a row to verify one.
  /// @param now monotonic clock [ns]
  /// @return why it cannot be looked at; empty if it is, whereupon an outcome will come
  std::string claim(const RigidTransform& room_from_patient, std::int64_t now);
  /// The claim that is being looked at, if there is one, counts for nothing; no outcome comes.
  void withdrawClaim();

  // What has come out; each is to be taken until there is none.
  std::optional<MotionDecision> takeDecision();
  std::optional<RefinementRequest> takeRequest();
  std::optional<ClaimOutcome> takeOutcome();
  std::optional<RegionProposal> takeProposal() { return proposer_.take(); }

  /// Where the patient is expected to be. @param stamp [ns]
  std::optional<PosePrediction> predict(std::int64_t stamp) const { return predictor_.predict(stamp); }
  const BeamGate& gate() const { return gate_; }
  /// What people say to the gate: hold, release, that a panel is there.
  BeamHold& beamHold() { return gate_.hold(); }
  const RefinementPolicy& refinement() const { return refinement_; }

private:
  /// The exposure that is being decided.
  struct Current
  {
    TrackedExposure exposure;
    ExposureEstimate tracks;
    bool due = false;                    ///< a registration is still to be asked
    std::optional<std::uint64_t> asked;  ///< the request that it waits for
    std::string not_registered;          ///< why it will not be registered
    std::vector<bool> without;           ///< views that are blind or silent, if two others are left
    bool untrained = false;              ///< its trackers have yet to learn, and nothing speaks against that
    std::optional<Refinement> refinement;
  };

  /// An exposure that was decided.
  struct Decided
  {
    TrackedExposure exposure;
    std::vector<bool> without;  ///< as Current's
  };

  struct Claim
  {
    RigidTransform room_from_patient;
    TrackedExposure exposure;              ///< the registered one, once it is asked
    std::optional<std::uint64_t> request;  ///< nothing before
    bool withdrawn = false;                ///< its answer is waited for, as one that was broken off would fail the next
  };

  /// Decides as far as it goes.
  void advance(std::int64_t now);
  void begin(std::int64_t now);
  bool waits(std::int64_t now) const;
  std::int64_t deadline() const;
  void decide(std::int64_t now);
  void ask(std::int64_t now);

  void askClaimed(std::int64_t now);
  void endClaim(const RefinementReply& reply);
  /// @return why it could not be applied; empty if it was
  std::string applyClaim(const Refinement& refinement);
  void refuseClaim(const std::string& why);

  void estimate();
  RefinementSeed seed() const;

  /// @return why it could not be applied; empty if it was
  std::string apply(const Refinement& refinement, const TrackedExposure& exposure);
  void applyLate(const Refinement& refinement);
  void tellGate(const MotionDecision& decision, std::int64_t now);
  /// Why the current exposure's pose, registered or tracked, might be worse than its covariance says; empty if nothing
  /// says so.
  std::string doubtOfRegistered() const;
  std::string doubtOfTracked() const;

  MotionMonitorOptions options_;
  Eigen::Vector3d target_centre_;
  ExposureEstimator tracks_;
  /// The last pose that is known, and its stamp [ns].
  std::optional<std::pair<std::int64_t, RigidTransform>> last_pose_;
  bool last_was_registered_ = false;
  PosePredictor predictor_;
  RefinementPolicy refinement_;
  BeamGate gate_;
  DecisionRules rules_;
  RegionProposer proposer_;
  ViewClarity clarity_;

  std::deque<TrackedExposure> waiting_;
  std::optional<Current> current_;
  /// The exposure that was decided without its registration, whose answer may still come.
  std::optional<TrackedExposure> late_;
  std::optional<Decided> latest_;  ///< without a fault
  std::optional<Claim> claim_;
  std::string claim_refusal_;  ///< of the last claim, since the last one that was accepted
  std::int64_t asked_ = 0;     ///< when the last request went out, monotonic clock [ns]
  /// What the last two answers took [ns]: a single one, as the first of a run, may be slow by itself.
  std::array<std::int64_t, 2> took_{};

  /// The last exposure in which tracks or a registration had a pose, published or not: the target cannot have gone
  /// anywhere unseen before. At first the last one before trackers began to learn: till then the patient is taken to be
  /// at the initial pose, as the first templates take it to be [ns].
  std::optional<std::int64_t> last_seen_;
  std::deque<MotionDecision> decisions_;
  std::optional<RefinementRequest> request_;
  std::optional<ClaimOutcome> outcome_;
};
}  // namespace xray_tracking
