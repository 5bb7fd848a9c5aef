#include "xray_tracking_motion_estimation/refinement_policy.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/Dense>
#include <boost/math/distributions/chi_squared.hpp>

namespace xray_tracking
{
namespace
{
// Registrations in a row that agree with each other.
constexpr int kChainWithoutTracks = 2;
constexpr int kChainAgainstTracks = 3;
// In a row that are not believed, where the tracks lead to.
constexpr int kUnbelieved = 3;

/// On the bound of a correction, whatever speaks for it: with 5 mm it stays nearer than half of the way to the next
/// vertebra, 18 mm in a neck, about.
constexpr double kMaxFactor = 2.0;

constexpr double kDegrees = 180.0 / EIGEN_PI;

constexpr double kSigmas = 3.0;
/// What two registrations of the same target are apart by that their covariances do not know of: twice the p95 of the
/// field's best figures [mm].
constexpr double kRegistrationSpread = 0.7;
/// How fast tissue in the regions gains on the target, at most: 1 mm (tissue_sigma) in a breath of 4 s is 1.6 mm/s at
/// its fastest, and a swallow makes three times as much [mm/s].
constexpr double kSlipSpeed = 5.0;

/// By how much a view alone may move the target [mm]: in images made at one time, of a room that is as it is said to
/// be, it is 0.1 at most (knee_real, thorax_01, phantom). Each exposure's
/// registration moves what tracks count from, so that tracks alone do not show a view that is late again and again.
constexpr double kViewsApart = 0.4;

/// Of a correlation coefficient of 0.9 over 4000 independent pixels, (1 - r^2) / sqrt(n): two poses that differ by less
/// are equally similar.
constexpr double kSimilarityNoise = 0.003;

template <typename... Parts>
std::string compose(const Parts&... parts)
{
  std::ostringstream text;
  text.precision(3);
  (text << ... << parts);
  return text.str();
}

/// How the registration's views contradict each other; empty if they do not.
std::string viewsApart(const RefinementReply& reply)
{
  return reply.pull <= kViewsApart
             ? std::string()
             : compose("the registration's views contradict each other: one alone would move the target by ",
                       reply.pull, " mm, expected at most ", kViewsApart, " mm");
}

/// (rotation vector, translation) of the target's centre from one pose to another, room axes.
Twist targetMotion(const RigidTransform& from, const RigidTransform& to, const Eigen::Vector3d& target_centre)
{
  return twistAbout(from * target_centre, to * from.inverse());
}
}  // namespace

RefinementMode refinementModeFromName(const std::string& name)
{
  static const std::pair<const char*, RefinementMode> kModes[] = { { "never", RefinementMode::NEVER },
                                                                   { "every_frame", RefinementMode::EVERY_FRAME },
                                                                   { "every_n", RefinementMode::EVERY_N },
                                                                   { "on_demand", RefinementMode::ON_DEMAND },
                                                                   { "on_drift", RefinementMode::ON_DRIFT } };
  for (const auto& [mode_name, mode] : kModes)
  {
    if (name == mode_name)
    {
      return mode;
    }
  }
  throw std::invalid_argument("refinement is \"" + name +
                              "\", expected never, every_frame, every_n, on_demand or on_drift");
}

void RefinementPolicyOptions::validate() const
{
  const auto require = [](bool valid, const char* key, double value, const char* expected)
  {
    if (!valid)
    {
      throw std::invalid_argument(compose(key, " is ", value, ", expected ", expected));
    }
  };
  const auto positive = [&](const char* key, double value, const char* unit)
  { require(value > 0.0 && std::isfinite(value), key, value, unit); };
  require(every_n >= 1, "every_n", every_n, "1 or more exposures");
  positive("drift", drift, "a number > 0 mm");
  positive("drift_rotation", drift_rotation, "a number > 0 rad");
  positive("drift_residual", drift_residual, "a number > 0 mm");
  positive("timeout", timeout, "a number > 0 s");
  positive("max_correction", max_correction, "a number > 0 mm");
  positive("max_correction_rotation", max_correction_rotation, "a number > 0 rad");
  require(target_speed >= 0.0 && std::isfinite(target_speed), "target_speed", target_speed, "a number >= 0 mm/s");
  require(std::isfinite(min_similarity), "min_similarity", min_similarity, "a number");
  require(significance > 0.0 && significance < 1.0, "significance", significance, "a number in (0, 1)");
}

RigidTransform Refinement::carry(const RigidTransform& tracked_then, const Eigen::Vector3d& target_centre) const
{
  return motionAbout(refined * target_centre, targetMotion(*tracked, tracked_then, target_centre)) * refined;
}

RefinementPolicy::RefinementPolicy(const RefinementPolicyOptions& options, const Eigen::Vector3d& target_centre)
  : options_(options), target_centre_(target_centre)
{
  options_.validate();
}

bool RefinementPolicy::due(const RefinementSeed& exposure, std::int64_t now)
{
  if (!anchor_)
  {
    anchor_ = exposure.room_from_patient;
  }
  exposures_since_request_ = std::min(exposures_since_request_ + 1, options_.every_n);
  if (demanded_)
  {
    return true;
  }
  switch (options_.mode)
  {
    case RefinementMode::EVERY_FRAME:
      return true;
    case RefinementMode::EVERY_N:
      return exposures_since_request_ >= options_.every_n;
    case RefinementMode::ON_DRIFT:
    {
      const Twist drift = targetMotion(*anchor_, exposure.room_from_patient, target_centre_);
      return now >= not_before_ &&
             (!exposure.tracked || drift.tail<3>().norm() > options_.drift ||
              drift.head<3>().norm() > options_.drift_rotation || exposure.disagreement > options_.drift_residual);
    }
    case RefinementMode::NEVER:
    case RefinementMode::ON_DEMAND:
      break;
  }
  return false;
}

RefinementRequest RefinementPolicy::ask(const RefinementSeed& exposure, bool unverified, std::int64_t now)
{
  if (pending_)
  {
    throw std::logic_error("a refinement is asked for while one is under way");
  }
  RefinementRequest request{ next_id_++, exposure.stamp, exposure.room_from_patient, unverified };
  // Unless there is a pose that is newer.
  if (!exposure.tracked && chain_ && 1e-9 * static_cast<double>(exposure.stamp - chain_->stamp) < exposure.since)
  {
    request.room_from_patient = chain_->refined;
  }
  pending_ = Pending{ request.id, now, exposure };
  if (unverified && unbelieved_ >= kUnbelieved && unbelieved_ % 2 != 0 && last_accepted_ &&
      exposure.stamp > last_accepted_->stamp)
  {
    // As if it were lost since then.
    const double since = 1e-9 * static_cast<double>(exposure.stamp - last_accepted_->stamp);
    request.room_from_patient = last_accepted_->refined;
    pending_->exposure = { exposure.stamp, last_accepted_->refined, PoseCovariance::Zero(), 0.0, false, since };
    pending_->where_it_was = true;
  }
  exposures_since_request_ = 0;
  not_before_ = now + static_cast<std::int64_t>(1e9 * options_.timeout);
  demanded_ = false;
  ++requests_;
  return request;
}

RefinementRequest RefinementPolicy::askClaimed(std::int64_t stamp, const RigidTransform& room_from_patient,
                                               std::int64_t now)
{
  if (pending_)
  {
    throw std::logic_error("a refinement is asked for while one is under way");
  }
  RefinementRequest request{ next_id_++, stamp, room_from_patient, true };
  pending_ = Pending{ request.id, now, { stamp, room_from_patient, PoseCovariance::Zero(), 0.0 }, true };
  ++requests_;
  return request;
}

bool RefinementPolicy::tick(std::int64_t now)
{
  if (!pending_ || 1e-9 * static_cast<double>(now - pending_->asked) <= options_.timeout)
  {
    return false;
  }
  pending_.reset();
  ++timeouts_;
  return true;
}

bool RefinementPolicy::demand()
{
  demanded_ = options_.mode != RefinementMode::NEVER;
  return demanded_;
}

void RefinementPolicy::extendChain(const RefinementReply& reply, std::int64_t stamp)
{
  Chain chain{ stamp, reply.room_from_patient, reply.covariance, 1, 1, 0 };
  if (chain_ && stamp > chain_->stamp)
  {
    const Twist way = targetMotion(chain_->refined, chain.refined, target_centre_);
    const double gone = options_.target_speed * 1e-9 * static_cast<double>(stamp - chain_->stamp);
    const double spread = kSigmas * worstSigma(chain_->refined, chain_->covariance, chain.refined, chain.covariance);
    const double bound = std::min(gone + spread, options_.max_correction) + kRegistrationSpread;
    if (way.tail<3>().norm() <= bound && way.head<3>().norm() <= options_.max_correction_rotation)
    {
      chain.length = std::min(chain_->length + 1, kChainWithoutTracks);
      chain.dense = gone < options_.max_correction ? std::min(chain_->dense + 1, kChainAgainstTracks) : 1;
      chain.against = std::min(chain_->against, kChainAgainstTracks);
    }
  }
  chain_ = chain;
}

RefinementPolicy::Judgement RefinementPolicy::judge(const RefinementReply& reply)
{
  if (!pending_ || reply.id != pending_->id)
  {
    throw std::logic_error("an answer to no request under way");
  }
  const Pending pending = *std::exchange(pending_, std::nullopt);
  const RefinementSeed& exposure = pending.exposure;
  if (pending.claimed)
  {
    return judgeClaimed(reply, exposure);
  }
  Judgement judgement{ RefinementVerdict::ACCEPTED, fault(reply), std::nullopt };
  bool outvoted = pending.where_it_was;
  if (!judgement.reason.empty())
  {
    judgement.verdict = RefinementVerdict::REFUSED;
    chain_.reset();
    ++unbelieved_;
  }
  else if (judgement.reason = viewsApart(reply); !judgement.reason.empty())
  {
    judgement.verdict = RefinementVerdict::CONTRADICTS;
    chain_.reset();
    ++unbelieved_;
  }
  else
  {
    extendChain(reply, exposure.stamp);
    judgement.reason = excess(reply, exposure, 1.0);
    if (judgement.reason.empty() && exposure.tracked)
    {
      judgement.reason = contradiction(reply, exposure);
      outvoted = !judgement.reason.empty() && chain_->dense >= kChainAgainstTracks;
      if (outvoted)
      {
        judgement.reason.clear();
      }
      if (judgement.reason.empty())
      {
        judgement.reason = leap(reply, exposure);
      }
    }
    chain_->against = exposure.tracked && !judgement.reason.empty() ? chain_->against + 1 : 0;
    if (chain_->against >= kChainAgainstTracks && excess(reply, exposure, kMaxFactor).empty())
    {
      outvoted = true;
      judgement.reason.clear();
    }
    if (!judgement.reason.empty())
    {
      judgement.verdict = exposure.tracked ? RefinementVerdict::CONTRADICTS : RefinementVerdict::REFUSED;
    }
    else if (!exposure.tracked && chain_->length < kChainWithoutTracks)
    {
      judgement.verdict = RefinementVerdict::UNCONFIRMED;
      judgement.reason = "the registration alone has found the target, which the next exposure has to confirm";
    }
    if (!pending.where_it_was)
    {
      unbelieved_ = 0;
    }
    else if (judgement.verdict == RefinementVerdict::REFUSED)
    {
      ++unbelieved_;  // unconfirmed, the next one starts there, too
    }
  }
  if (judgement.verdict != RefinementVerdict::ACCEPTED)
  {
    ++refused_;
    last_refusal_ = judgement.reason;
    return judgement;
  }
  ++accepted_;
  unbelieved_ = 0;
  anchor_ = reply.room_from_patient;
  last_accepted_ = Accepted{ exposure.stamp, reply.room_from_patient, reply.covariance };
  not_before_ = 0;
  judgement.refinement = Refinement{ exposure.stamp,
                                     exposure.tracked ? std::make_optional(exposure.room_from_patient) : std::nullopt,
                                     reply.room_from_patient,
                                     reply.covariance,
                                     outvoted,
                                     false };
  return judgement;
}

RefinementPolicy::Judgement RefinementPolicy::judgeClaimed(const RefinementReply& reply, const RefinementSeed& claim)
{
  Judgement judgement{ RefinementVerdict::ACCEPTED, fault(reply), std::nullopt };
  if (judgement.reason.empty())
  {
    judgement.reason = viewsApart(reply);
  }
  if (judgement.reason.empty() && !excess(reply, claim, 1.0).empty())
  {
    const Twist correction = targetMotion(claim.room_from_patient, reply.room_from_patient, target_centre_);
    judgement.reason =
        compose("the registration finds the target ", correction.tail<3>().norm(), " mm and ",
                kDegrees * correction.head<3>().norm(), " degrees from where it was stated to be, expected at most ",
                options_.max_correction, " mm and ", kDegrees * options_.max_correction_rotation, " degrees");
  }
  if (!judgement.reason.empty())
  {
    judgement.verdict = RefinementVerdict::REFUSED;
    ++refused_;
    return judgement;
  }
  ++accepted_;
  unbelieved_ = 0;
  chain_ = Chain{ claim.stamp, reply.room_from_patient, reply.covariance, 1, 1, 0 };
  anchor_ = reply.room_from_patient;
  last_accepted_ = Accepted{ claim.stamp, reply.room_from_patient, reply.covariance };
  not_before_ = 0;
  judgement.refinement =
      Refinement{ claim.stamp, std::nullopt, reply.room_from_patient, reply.covariance, false, true };
  return judgement;
}

std::string RefinementPolicy::fault(const RefinementReply& reply) const
{
  if (!reply.success)
  {
    return reply.text.empty() ? "the registration failed" : reply.text;
  }
  if (!isRigid(reply.room_from_patient) || !reply.covariance.allFinite() || !std::isfinite(reply.similarity))
  {
    return "the refined pose, its covariance or its similarity is not finite";
  }
  if (Eigen::LLT<PoseCovariance>(reply.covariance).info() != Eigen::Success)
  {
    return "the refined pose's covariance is not known: expected a positive definite one";
  }
  if (!(reply.similarity >= options_.min_similarity) || !(reply.similarity >= reply.seed_similarity - kSimilarityNoise))
  {
    return compose("the similarity is ", reply.similarity, ", expected at least ", options_.min_similarity,
                   " and the seed's ", reply.seed_similarity);
  }
  return std::string();
}

std::string RefinementPolicy::excess(const RefinementReply& reply, const RefinementSeed& exposure, double factor) const
{
  const Twist correction = targetMotion(exposure.room_from_patient, reply.room_from_patient, target_centre_);
  const double gone = exposure.tracked ? 0.0 : options_.target_speed * exposure.since;
  const double bound = std::min(factor * options_.max_correction + gone, kMaxFactor * options_.max_correction);
  const double rotation_bound = factor * options_.max_correction_rotation;
  return correction.tail<3>().norm() <= bound && correction.head<3>().norm() <= rotation_bound
             ? std::string()
             : compose("the correction is ", correction.tail<3>().norm(), " mm and ", correction.head<3>().norm(),
                       " rad, expected at most ", bound, " mm and ", rotation_bound, " rad");
}

std::string RefinementPolicy::contradiction(const RefinementReply& reply, const RefinementSeed& exposure) const
{
  const Twist correction = targetMotion(exposure.room_from_patient, reply.room_from_patient, target_centre_);
  const PoseCovariance covariance = covarianceAt(target_centre_, exposure.room_from_patient, exposure.covariance) +
                                    covarianceAt(target_centre_, reply.room_from_patient, reply.covariance);
  Eigen::Matrix<double, 6, 1> difference;
  difference << correction.tail<3>(), correction.head<3>();
  const Eigen::LLT<PoseCovariance> cholesky(covariance);
  const double chi_square = difference.dot(cholesky.solve(difference));
  const double limit =
      boost::math::quantile(boost::math::complement(boost::math::chi_squared(6), options_.significance));
  if (cholesky.info() != Eigen::Success || !(chi_square <= limit))
  {
    return compose(
        "the refinement contradicts the tracked pose: chi-square of "
        "the correction is ",
        chi_square, " with 6 degrees of freedom, expected at most ", limit);
  }
  return std::string();
}

std::string RefinementPolicy::leap(const RefinementReply& reply, const RefinementSeed& exposure) const
{
  if (!last_accepted_ || exposure.stamp <= last_accepted_->stamp)
  {
    return std::string();
  }
  const RigidTransform& before = last_accepted_->refined;
  const double off = targetMotion(exposure.room_from_patient, reply.room_from_patient, target_centre_).tail<3>().norm();
  const double since = 1e-9 * static_cast<double>(exposure.stamp - last_accepted_->stamp);
  const double spread =
      kSigmas * worstSigma(before, last_accepted_->covariance, reply.room_from_patient, reply.covariance);
  const double bound = kSlipSpeed * since + spread + kRegistrationSpread;
  return off <= bound
             ? std::string()
             : compose("the refinement leaps: the target is ", off, " mm from where the tracks have gone since ",
                       "the one ", since, " s before, expected at most ", bound, " mm");
}

double RefinementPolicy::worstSigma(const RigidTransform& one, const PoseCovariance& its_covariance,
                                    const RigidTransform& other, const PoseCovariance& other_covariance) const
{
  const PoseCovariance covariance =
      covarianceAt(target_centre_, one, its_covariance) + covarianceAt(target_centre_, other, other_covariance);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(covariance.topLeftCorner<3, 3>(), Eigen::EigenvaluesOnly);
  return std::sqrt(axes.eigenvalues()[2]);
}

void RefinementPolicy::reset()
{
  last_accepted_.reset();
  unbelieved_ = 0;
  pending_.reset();
  chain_.reset();
  anchor_.reset();
  exposures_since_request_ = 0;
  demanded_ = false;
  not_before_ = 0;
}
}  // namespace xray_tracking
