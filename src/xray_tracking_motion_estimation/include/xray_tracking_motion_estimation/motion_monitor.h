#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_motion_estimation/beam_gate.h"
#include "xray_tracking_motion_estimation/exposure_estimator.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"
#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
/// Which poses are published.
enum class PoseMethod
{
  TRACKING,                  ///< tracked ones; registrations move what they count from
  REGISTRATION,              ///< registered ones, found from the last one on
  TRACKING_AND_REGISTRATION  ///< registered ones, found from the tracked pose on; where there is none, tracked ones
};

/// @throws std::invalid_argument if `name` is none of tracking, registration, tracking_and_registration
PoseMethod poseMethodFromName(const std::string& name);
const char* poseMethodName(PoseMethod method);

/// The members' defaults but for what patients ask for; as the node's parameters.
struct MotionMonitorOptions
{
  MotionMonitorOptions();

  PoseMethod method = PoseMethod::TRACKING;
  /// How long an exposure waits, from when it was tracked, for its registered pose [s], 0 to 10.
  double deadline = 0.1;
  ExposureEstimatorOptions tracks;
  double rigid_sigma =
      0.027;  ///< floor of ConsistencyOptions for a rigid target, which `views_differ` follows from, > 0
  PosePredictorOptions prediction;
  BeamGateOptions gate;
  RefinementPolicyOptions refinement;

  /// Sets what follows from other members: what the consistency monitors, the prediction, the gate and the refinement
  /// have to know of the rest. @throws std::invalid_argument naming the key, its value and what was expected
  void derive();
};

/// Where a published pose comes from; values as in xray_tracking_msgs/PatientMotion.
enum class PoseSource : std::uint8_t
{
  NONE = 0,
  TRACKED = 1,
  REGISTERED = 2
};

/// What is said of an exposure, once.
struct MotionDecision
{
  std::int64_t stamp = 0;  ///< [ns]
  MotionState state = MotionState::WAITING;
  std::string reason;  ///< why there is no pose; empty if there is one

  PoseSource source = PoseSource::NONE;
  std::string not_registered;  ///< why the pose is not a registered one; empty if it is
  RigidTransform room_from_patient = RigidTransform::Identity();
  /// Of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes [rad]).
  PoseCovariance pose_covariance = PoseCovariance::Zero();
  /// Of the target's centre since the initial pose, room axes [mm], and its covariance [mm^2].
  Eigen::Vector3d displacement = Eigen::Vector3d::Zero();
  Eigen::Matrix3d displacement_covariance = Eigen::Matrix3d::Zero();

  // Of the tracks, whatever the source; zeros where there is no estimate.
  bool views_differ = false;
  double disagreement = 0.0;  ///< [px]
  double chi_square = 0.0;
  int degrees_of_freedom = 0;
  int views = 0;  ///< that took part

  double cpu_seconds = 0.0;   ///< of trackers
  double wall_seconds = 0.0;  ///< from the images' arrival
};

/// A view whose region is to be learnt anew.
struct RegionProposal
{
  std::size_t view;
  cv::Rect region;  ///< where the target is seen now, as far as it is in the image [px]
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
  /// @param room_from_patient the setup's initial pose; @param target_centre patient frame [mm]
  /// @throws std::invalid_argument for bad options
  MotionMonitor(const MotionMonitorOptions& options, const RigidTransform& room_from_patient,
                const Eigen::Vector3d& target_centre);

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

  /// Time starts again: all but the geometry is forgotten, and what waits.
  /// @param doubt why the patient may be elsewhere than at the initial pose: no pose until a refinement confirms one;
  /// empty if it is taken to be there
  void restart(const std::string& doubt);

  /// The next exposure is to be refined. @return false if registrations are never asked for
  bool demandRefinement() { return refinement_.demand(); }

  // What has come out; each is to be taken until there is none.
  std::optional<MotionDecision> takeDecision();
  std::optional<RefinementRequest> takeRequest();
  std::optional<RegionProposal> takeProposal();

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
    std::optional<Refinement> refinement;
  };

  /// Decides as far as it goes.
  void advance(std::int64_t now);
  void begin(std::int64_t now);
  bool waits(std::int64_t now) const;
  std::int64_t deadline() const;
  void decide(std::int64_t now);
  void ask(std::int64_t now);

  void estimate();
  RefinementSeed seed() const;

  /// @return why it could not be applied; empty if it was
  std::string apply(const Refinement& refinement, const TrackedExposure& exposure);
  void applyLate(const Refinement& refinement);
  /// Of views that have lost the target, or follow something else, while the current exposure is registered.
  void proposeRegions();
  /// Whether a view's track is far from where the registration sees the target. @param region its, there [px]
  bool followsOther(std::size_t view, const cv::Rect& region) const;
  MotionDecision decisionOf(std::int64_t now) const;
  void tellGate(const MotionDecision& decision, std::int64_t now);
  Eigen::Vector3d displacement(const RigidTransform& room_from_patient) const;
  double rotation(const RigidTransform& room_from_patient) const;

  MotionMonitorOptions options_;
  RigidTransform initial_pose_;
  Eigen::Vector3d target_centre_;
  ExposureEstimator tracks_;
  /// The last pose that is known, and its stamp [ns].
  std::optional<std::pair<std::int64_t, RigidTransform>> last_pose_;
  bool last_was_registered_ = false;
  PosePredictor predictor_;
  RefinementPolicy refinement_;
  BeamGate gate_;

  std::deque<TrackedExposure> waiting_;
  std::optional<Current> current_;
  /// The exposure that was decided without its registration, whose answer may still come.
  std::optional<TrackedExposure> late_;
  std::int64_t asked_ = 0;  ///< when the last request went out, monotonic clock [ns]
  /// What the last two answers took [ns]: a single one, as the first of a run, may be slow by itself.
  std::array<std::int64_t, 2> took_{};

  std::string unconfirmed_;    ///< why no pose is believed before a refinement is accepted; empty if none is needed
  std::string contradiction_;  ///< of registration and tracks, until it is resolved; empty if there is none
  /// The last exposure in which tracks or a registration had a pose, published or not: the target cannot have gone
  /// anywhere unseen before. At first the first one since the start [ns].
  std::optional<std::int64_t> last_seen_;
  /// Of a view that does not follow the target.
  struct Astray
  {
    int exposures = 0;                       ///< in a row
    std::optional<std::int64_t> proposed{};  ///< stamp of the last proposal
  };
  std::vector<Astray> astray_;

  std::deque<MotionDecision> decisions_;
  std::optional<RefinementRequest> request_;
  std::deque<RegionProposal> proposals_;
};
}  // namespace xray_tracking
