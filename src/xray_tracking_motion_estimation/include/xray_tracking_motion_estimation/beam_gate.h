#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include <Eigen/Core>
#include <boost/circular_buffer.hpp>

#include "xray_tracking_motion_estimation/beam_hold.h"
#include "xray_tracking_motion_estimation/pose_verification.h"

namespace xray_tracking
{
/// Why the beam is to be held; values as in xray_tracking_msgs/BeamGate.
enum class GateReason : std::uint8_t
{
  NONE = 0,          ///< it need not be held
  NO_EXPOSURE = 1,   ///< nothing since start or reset
  NOT_MEASURED = 2,  ///< the latest exposure has no pose: lost, waiting, no reference, numbers that are none
  INCONSISTENT = 3,  ///< its views contradict each other
  STALE = 4,         ///< the latest exposure is too old
  BAD_STAMP = 5,     ///< it is stamped in the future, or no later than the one before
  UNCERTAIN = 6,     ///< its covariance is over the bound, or there is a doubt (GateExposure::doubt)
  DISPLACED = 7,     ///< the target is too far from where it should be, or turned too much
  JUMP = 8,          ///< the target moved faster than a body does, which nothing has confirmed so far
  CONFIRMING = 9,    ///< good, but not for long enough
  UNVERIFIED = 10,   ///< nothing has confirmed where the target is, or not for too long
  HELD = 11          ///< people hold it, see BeamHold: before all that is judged
};

/// As in the enumeration.
const char* gateReasonName(GateReason reason);

struct BeamGateOptions
{
  /// Age from which the latest exposure is stale, in exposure intervals (which are estimated), >= 1.
  double max_age = 3.0;

  /// An exposure interval is never taken to be longer than this [s], > 0: whatever the rate, stale is stale.
  double max_interval = 0.5;

  /// Distance of the target's centre from its planned place [mm], > 0.
  double max_displacement = 3.0;

  /// Rotation of the target from its planned one [rad], > 0, its standard deviation about the worst axis included (root
  /// of the sum of squares): what no track measures of a rotation is not taken for none.
  double max_rotation = 0.0524;

  /// Standard deviation of the target's centre in its worst direction [mm], > 0.
  double max_sigma = 1.5;

  /// The same of a pose that tracks have led to since the last registration, where a registration is asked [mm], > 0;
  /// the smaller of both counts. A third of an error of 1.5 mm: of random sequences without it (seeds 7001 to 7140, on
  /// which it was chosen) three tracked poses with 0.66 to 0.83 mm were off by more under an open gate.
  double max_tracked_sigma = 0.5;

  /// Speed of the target's centre from one exposure to the next that a body can have [mm/s], > 0. Breathing makes up to
  /// 40; the noise of two exposures 0.1 s apart or less adds to it.
  double max_speed = 60.0;

  /// Good exposures in a row before the beam need not be held, >= 2.
  int good_exposures = 5;

  /// The same after a jump that no refinement has confirmed, >= good_exposures.
  int jump_exposures = 30;

  PoseVerificationOptions verification;
  BeamHoldOptions hold;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

/// What the gate has to know of an exposure.
struct GateExposure
{
  std::int64_t stamp = 0;    ///< exposure time [ns]
  std::int64_t arrival = 0;  ///< when its pose was there, monotonic clock [ns]
  std::int64_t delay = 0;    ///< from exposure to arrival, by the clock that stamps are of [ns]

  /// NONE if it has a pose; NOT_MEASURED, INCONSISTENT or BAD_STAMP (stamped in the future) otherwise, with a text.
  GateReason fault = GateReason::NOT_MEASURED;
  std::string text;

  /// Why this exposure's pose might be worse than its covariance says; empty if there is no such doubt.
  std::string doubt;

  /// The pose is an accepted registration's: it verifies itself, and no jump is left unconfirmed.
  bool registered = false;

  Eigen::Vector3d displacement = Eigen::Vector3d::Zero();  ///< target's centre from its planned place, room axes [mm]
  double rotation = 0.0;                                   ///< from the planned one [rad]
  double rotation_variance = 0.0;  ///< of the rotation about its worst axis, what nobody measures included [rad^2]
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of the displacement [mm^2]
};

/// Whether the beam is to be held, and why. Advice of research software, see docs/safety.md.
///
/// Fails closed: open only while the latest exposure is young, has a pose that is verified and within all bounds, and
/// the ones before it were, too, and nobody holds the beam. Exposures are judged all the same while it is held. No
/// clock of its own: tick() has to be called often, so that silence closes it.
class BeamGate
{
public:
  /// @throws std::invalid_argument for bad options
  explicit BeamGate(const BeamGateOptions& options);

  /// @return true if reason() has changed
  bool update(const GateExposure& exposure);
  /// @param now monotonic clock [ns]
  bool tick(std::int64_t now);

  /// A refinement of an earlier exposure was accepted, which verifies its pose: what moved the target's displacement by
  /// `correction` [mm] is no motion. A jump up to the refined exposure is confirmed by it.
  /// @param stamp the refined exposure's [ns]; @param rotation of the target from its planned one by now [rad]
  /// @return true if reason() has changed
  bool refined(std::int64_t stamp, const Eigen::Vector3d& correction, double rotation);

  /// A refinement was not accepted, see PoseVerification. @return true if reason() has changed
  bool refused(const std::string& why, bool contradicts);

  /// The pose that all motion is counted from might be wrong: closed until a refinement is accepted.
  /// @return true if reason() has changed
  bool doubt(const std::string& why);

  /// The target is elsewhere than was taken so far: somebody has stated where, and an accepted refinement of an
  /// exposure confirms it. Closed until exposures are good there.
  /// @param stamp the exposure's [ns]
  /// @param displacement, rotation of the target there [mm, rad]
  /// @param refusal why the last such statement was refused, which makes it take two refinements in a row; empty if
  /// none was
  /// @return true if reason() has changed
  bool stated(std::int64_t stamp, const Eigen::Vector3d& displacement, double rotation, const std::string& refusal);

  /// Goes on from where the target was before a restart of the process. Where it is next may be a jump that nobody has
  /// seen: that is confirmed by a refinement, or by as many good exposures as after one.
  /// @param stamp of the exposure [ns]; @param displacement of the target then [mm]
  /// @param doubt why that is not verified; empty if it is as verified as an initial pose
  /// @return true if reason() has changed
  bool takeUp(std::int64_t stamp, const Eigen::Vector3d& displacement, const std::string& doubt);

  /// Time starts again, or the reference is another: as at the start, but for the text.
  bool reset(const std::string& why);

  /// What people say; reset() does not end it.
  BeamHold& hold() { return hold_; }

  bool open() const { return reason() == GateReason::NONE; }
  GateReason reason() const { return hold_.held() ? GateReason::HELD : reason_; }
  std::string text() const;  ///< why, for people, figures rounded; never empty
  const PoseVerification& verification() const { return verification_; }

  /// Of the latest exposure; zero if there is none.
  const Eigen::Vector3d& displacement() const { return displacement_; }
  double rotation() const { return rotation_; }
  /// Since the latest exposure was taken [ns]; nothing if there is none.
  std::optional<std::int64_t> age(std::int64_t now) const;
  /// Age from which the latest exposure is stale [ns].
  std::int64_t maxAge() const;

private:
  struct Verdict
  {
    GateReason reason;
    std::string text;
  };
  Verdict judge(const GateExposure& exposure) const;
  /// JUMP or NONE, by the latest place before. Of a registered pose NONE.
  Verdict judgeSpeed(const GateExposure& exposure) const;
  /// DISPLACED or NONE.
  Verdict judgePlace() const;
  bool change(Verdict verdict);
  bool good() const { return reason_ == GateReason::NONE; }
  /// After something about the verification has changed.
  bool reviewVerification();
  std::int64_t interval() const;
  /// However long it is.
  std::int64_t usualInterval() const;

  BeamGateOptions options_;
  PoseVerification verification_;
  BeamHold hold_;
  GateReason reason_ = GateReason::NO_EXPOSURE;  ///< by the exposures alone, as is the text
  std::string text_ = "no exposure so far";

  std::optional<std::int64_t> last_stamp_;  ///< of the latest exposure
  std::int64_t last_exposed_ = 0;           ///< when it was taken, monotonic clock
  boost::circular_buffer<std::int64_t> intervals_;
  Eigen::Vector3d displacement_ = Eigen::Vector3d::Zero();
  double rotation_ = 0.0;
  double rotation_variance_ = 0.0;

  std::optional<std::pair<std::int64_t, Eigen::Vector3d>> last_place_;  ///< stamp, displacement; latest with a pose
  int good_ = 0;
  std::optional<std::int64_t> jump_;  ///< stamp of the latest one that is unconfirmed
};
}  // namespace xray_tracking
