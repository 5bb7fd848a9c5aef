#include "xray_tracking_motion_estimation/beam_gate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iomanip>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/Eigenvalues>

namespace xray_tracking
{
namespace
{
/// The median of so many is right while fewer than half of the exposures are missing.
constexpr std::size_t kIntervals = 31;

template <typename... Parts>
std::string compose(const Parts&... parts)
{
  std::ostringstream text;
  text.precision(3);
  (text << ... << parts);
  return text.str();
}

double seconds(std::int64_t nanoseconds)
{
  return 1e-9 * static_cast<double>(nanoseconds);
}

/// Rounded for people.
std::string rounded(double value, int decimals)
{
  std::ostringstream text;
  text << std::fixed << std::setprecision(decimals) << value;
  return text.str();
}

std::string millimetres(double value)
{
  return rounded(value, 2) + " mm";
}

std::string degrees(double radians)
{
  return rounded(radians * 180.0 / EIGEN_PI, 1) + " degrees";
}
}  // namespace

const char* gateReasonName(GateReason reason)
{
  static const char* const kNames[] = { "NONE",  "NO_EXPOSURE", "NOT_MEASURED", "INCONSISTENT",
                                        "STALE", "BAD_STAMP",   "UNCERTAIN",    "DISPLACED",
                                        "JUMP",  "CONFIRMING",  "UNVERIFIED",   "HELD" };
  return kNames[static_cast<std::size_t>(reason)];
}

void BeamGateOptions::validate() const
{
  const auto require = [](bool valid, const char* key, double value, const char* expected)
  {
    if (!valid)
    {
      throw std::invalid_argument(compose(key, " is ", value, ", expected ", expected));
    }
  };
  const auto positive = [&](const char* key, double value, const char* expected)
  { require(value > 0.0 && std::isfinite(value), key, value, expected); };
  require(max_age >= 1.0 && std::isfinite(max_age), "max_age", max_age, "a number >= 1, in exposure intervals");
  positive("max_interval", max_interval, "a number > 0 s");
  positive("max_displacement", max_displacement, "a number > 0 mm");
  positive("max_rotation", max_rotation, "a number > 0 rad");
  positive("max_sigma", max_sigma, "a number > 0 mm");
  positive("max_tracked_sigma", max_tracked_sigma, "a number > 0 mm");
  positive("max_speed", max_speed, "a number > 0 mm/s");
  require(good_exposures >= 2, "good_exposures", good_exposures, "2 or more");
  require(jump_exposures >= good_exposures, "jump_exposures", jump_exposures, "good_exposures or more");
  verification.validate();
  hold.validate();
}

BeamGate::BeamGate(const BeamGateOptions& options)
  : options_(options), verification_(options.verification), hold_(options.hold), intervals_(kIntervals)
{
  options_.validate();
}

std::int64_t BeamGate::interval() const
{
  return std::min(usualInterval(), static_cast<std::int64_t>(1e9 * options_.max_interval));
}

std::int64_t BeamGate::usualInterval() const
{
  if (intervals_.empty())
  {
    return static_cast<std::int64_t>(1e9 * options_.max_interval);
  }
  std::array<std::int64_t, kIntervals> sorted{};
  const auto end = std::copy(intervals_.begin(), intervals_.end(), sorted.begin());
  // The lower one of two middles: rather too strict.
  const auto middle = sorted.begin() + (intervals_.size() - 1) / 2;
  std::nth_element(sorted.begin(), middle, end);
  return *middle;
}

std::int64_t BeamGate::maxAge() const
{
  return static_cast<std::int64_t>(options_.max_age * static_cast<double>(interval()));
}

std::optional<std::int64_t> BeamGate::age(std::int64_t now) const
{
  return last_stamp_ ? std::optional<std::int64_t>(now - last_exposed_) : std::nullopt;
}

BeamGate::Verdict BeamGate::judge(const GateExposure& exposure) const
{
  if (exposure.fault != GateReason::NONE)
  {
    return { exposure.fault, exposure.text.empty() ? "no pose" : exposure.text };
  }
  if (!exposure.displacement.allFinite() || !std::isfinite(exposure.rotation) ||
      !std::isfinite(exposure.rotation_variance) || !exposure.covariance.allFinite())
  {
    return { GateReason::NOT_MEASURED, "the pose is not finite" };
  }
  if (exposure.delay > maxAge())
  {
    return { GateReason::STALE, compose("the exposure was ", seconds(exposure.delay),
                                        " s old when its pose came, expected at most ", seconds(maxAge()), " s") };
  }
  if (Verdict verdict = judgeSpeed(exposure); verdict.reason != GateReason::NONE)
  {
    return verdict;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(exposure.covariance, Eigen::EigenvaluesOnly);
  const double variance = axes.eigenvalues()[2];
  const bool between_registrations = options_.verification.registration && !exposure.registered;
  const double max_sigma =
      between_registrations ? std::min(options_.max_tracked_sigma, options_.max_sigma) : options_.max_sigma;
  if (!(axes.eigenvalues()[0] >= -1e-9 * variance) || variance > max_sigma * max_sigma)
  {
    return { GateReason::UNCERTAIN,
             compose("the displacement's standard deviation is ", millimetres(std::sqrt(variance)),
                     ", expected at most ", millimetres(max_sigma),
                     between_registrations ? " of a tracked pose" : "") };
  }
  if (!exposure.doubt.empty())
  {
    return { GateReason::UNCERTAIN, exposure.doubt };
  }
  return { GateReason::NONE, "" };
}

BeamGate::Verdict BeamGate::judgeSpeed(const GateExposure& exposure) const
{
  if (last_place_ && !exposure.registered)
  {
    // Over a longer time than exposures stay young, nothing vouches for the way in between.
    const double elapsed = seconds(std::min(exposure.stamp - last_place_->first, maxAge()));
    const double distance = (exposure.displacement - last_place_->second).norm();
    if (distance > options_.max_speed * elapsed)
    {
      return { GateReason::JUMP,
               compose("the target moved by ", millimetres(distance), ", at ", std::round(distance / elapsed),
                       " mm/s, expected at most ", options_.max_speed) };
    }
  }
  return { GateReason::NONE, "" };
}

BeamGate::Verdict BeamGate::judgePlace() const
{
  const double distance = displacement_.norm();
  if (distance > options_.max_displacement ||
      std::hypot(rotation_, std::sqrt(rotation_variance_)) > options_.max_rotation)
  {
    return { GateReason::DISPLACED,
             compose("the target is displaced by ", millimetres(distance), " and turned by ", degrees(rotation_),
                     ", known to ", degrees(std::sqrt(rotation_variance_)), ", expected at most ",
                     millimetres(options_.max_displacement), " and ", degrees(options_.max_rotation)) };
  }
  return { GateReason::NONE, "" };
}

bool BeamGate::update(const GateExposure& exposure)
{
  if (exposure.fault == GateReason::BAD_STAMP)
  {
    // Nothing of it is kept: what follows has right stamps and would seem to be older.
    good_ = 0;
    return change({ GateReason::BAD_STAMP, exposure.text.empty() ? "the exposure's stamp is wrong" : exposure.text });
  }
  if (last_stamp_ && exposure.stamp <= *last_stamp_)
  {
    good_ = 0;
    return change(
        { GateReason::BAD_STAMP, compose("the exposure at ", exposure.stamp, " ns is no later than the one at ",
                                         *last_stamp_, " ns before it") });
  }
  const std::optional<std::int64_t> previous = last_stamp_;
  if (previous)
  {
    intervals_.push_back(exposure.stamp - *previous);
  }
  last_stamp_ = exposure.stamp;
  last_exposed_ = exposure.arrival - exposure.delay;
  verification_.update(exposure.stamp, usualInterval());

  Verdict verdict = judge(exposure);
  const bool measured = exposure.fault == GateReason::NONE && verdict.reason != GateReason::NOT_MEASURED;
  if (measured)
  {
    // Also of an exposure that is refused for its stamp or age: the next one is compared with it.
    if (judgeSpeed(exposure).reason == GateReason::JUMP)
    {
      jump_ = exposure.stamp;
    }
    displacement_ = exposure.displacement;
    rotation_ = exposure.rotation;
    rotation_variance_ = std::max(0.0, exposure.rotation_variance);
    last_place_.emplace(exposure.stamp, exposure.displacement);
    if (exposure.registered)
    {
      jump_.reset();
      verification_.confirm(exposure.stamp);
    }
    if (verdict.reason == GateReason::NONE)
    {
      verdict = judgePlace();
    }
  }

  // A missing exposure is a missed chance to see that something is wrong, if it is missing for long.
  const bool gap = previous && exposure.stamp - *previous > maxAge();
  good_ = verdict.reason != GateReason::NONE ? 0 : gap ? 1 : good_ + 1;
  // Before all that is said of the target's place: while nothing is verified that is a guess. Whether exposures are
  // good otherwise is seen meanwhile.
  if (std::string fault = verification_.fault(); measured && verdict.reason != GateReason::STALE && !fault.empty())
  {
    good_ = good() ? 0 : good_;
    return change({ GateReason::UNVERIFIED, std::move(fault) });
  }
  if (verdict.reason != GateReason::NONE)
  {
    return change(verdict);
  }
  const int needed = jump_ ? options_.jump_exposures : options_.good_exposures;
  if (good_ >= needed)
  {
    jump_.reset();
    return good() ? false : change({ GateReason::NONE, compose(good_, " good exposures in a row") });
  }
  return change({ jump_ ? GateReason::JUMP : GateReason::CONFIRMING,
                  jump_ ? compose("an earlier jump is unconfirmed until ", needed, " good exposures or a refinement")
                        : compose("good, but needs ", needed, " good exposures in a row") });
}

bool BeamGate::tick(std::int64_t now)
{
  const GateReason before = reason();
  hold_.tick(now);
  if (last_stamp_ && *age(now) > maxAge())
  {
    good_ = 0;
    change({ GateReason::STALE, compose("the latest exposure is ", seconds(*age(now)), " s old, expected at most ",
                                        seconds(maxAge()), " s") });
  }
  return reason() != before;
}

std::string BeamGate::text() const
{
  return hold_.held() ? hold_.why() + "; otherwise: " + text_ : text_;
}

bool BeamGate::refined(std::int64_t stamp, const Eigen::Vector3d& correction, double rotation)
{
  displacement_ += correction;
  rotation_ = rotation;
  if (last_place_)
  {
    last_place_->second += correction;
  }
  if (jump_ && stamp >= *jump_)
  {
    jump_.reset();
    good_ = 0;
  }
  verification_.confirm(stamp);
  const Verdict verdict = judgePlace();
  if (verdict.reason == GateReason::DISPLACED && (good() || reason_ == GateReason::DISPLACED))
  {
    good_ = 0;
    return change(verdict);
  }
  if (reason_ == GateReason::DISPLACED)
  {
    // What it says of the place is not so any more; what else was wrong with the exposure, the next one tells.
    std::string fault = verification_.fault();
    return fault.empty() ? change({ GateReason::CONFIRMING,
                                    "a registration has found the target within its bounds, but the next exposure has "
                                    "to be good, too" })
                         : change({ GateReason::UNVERIFIED, std::move(fault) });
  }
  return reviewVerification();
}

bool BeamGate::refused(const std::string& why, bool contradicts)
{
  verification_.refuse(why, contradicts);
  good_ = contradicts ? 0 : good_;
  return reviewVerification();
}

bool BeamGate::doubt(const std::string& why)
{
  verification_.doubt(why);
  good_ = 0;
  return reviewVerification();
}

bool BeamGate::takeUp(std::int64_t stamp, const Eigen::Vector3d& displacement, const std::string& doubt)
{
  last_place_.emplace(stamp, displacement);
  jump_ = stamp;
  good_ = 0;
  if (!doubt.empty())
  {
    verification_.doubt(doubt);
  }
  return reviewVerification();
}

bool BeamGate::stated(std::int64_t stamp, const Eigen::Vector3d& displacement, double rotation,
                      const std::string& refusal)
{
  displacement_ = displacement;
  rotation_ = rotation;
  last_place_.emplace(stamp, displacement);
  jump_.reset();
  good_ = 0;
  verification_.restart();
  verification_.doubt("no registration has confirmed the pose that was stated");
  if (!refusal.empty())
  {
    verification_.refuse(refusal, false);
  }
  verification_.confirm(stamp);
  if (std::string fault = verification_.fault(); !fault.empty())
  {
    return change({ GateReason::UNVERIFIED, std::move(fault) });
  }
  return change(
      { GateReason::CONFIRMING, "registered where it was stated to be, but exposures have to be good there" });
}

bool BeamGate::reviewVerification()
{
  // Other reasons stand until the next exposure.
  if (!good() && reason_ != GateReason::UNVERIFIED)
  {
    return false;
  }
  if (std::string fault = verification_.fault(); !fault.empty())
  {
    return change({ GateReason::UNVERIFIED, std::move(fault) });
  }
  return good() ? false : change({ GateReason::CONFIRMING, "verified, but the next exposure has to be good, too" });
}

bool BeamGate::reset(const std::string& why)
{
  last_stamp_.reset();
  last_place_.reset();
  intervals_.clear();
  displacement_.setZero();
  rotation_ = 0.0;
  rotation_variance_ = 0.0;
  good_ = 0;
  jump_.reset();
  verification_.restart();
  return change({ GateReason::NO_EXPOSURE, why });
}

bool BeamGate::change(Verdict verdict)
{
  text_ = std::move(verdict.text);
  return std::exchange(reason_, verdict.reason) != verdict.reason && !hold_.held();
}
}  // namespace xray_tracking
