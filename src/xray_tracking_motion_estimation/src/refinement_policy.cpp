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
template <typename... Parts>
std::string compose(const Parts&... parts)
{
  std::ostringstream text;
  (text << ... << parts);
  return text.str();
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
  require(queue_size >= 1, "queue_size", queue_size, "1 or more exposures");
  positive("drift", drift, "a number > 0 mm");
  positive("drift_rotation", drift_rotation, "a number > 0 rad");
  positive("drift_residual", drift_residual, "a number > 0 mm");
  positive("timeout", timeout, "a number > 0 s");
  positive("max_correction", max_correction, "a number > 0 mm");
  positive("max_correction_rotation", max_correction_rotation, "a number > 0 rad");
  require(std::isfinite(min_similarity), "min_similarity", min_similarity, "a number");
  require(significance > 0.0 && significance < 1.0, "significance", significance, "a number in (0, 1)");
}

RigidTransform Refinement::carry(const RigidTransform& tracked_then, const Eigen::Vector3d& target_centre) const
{
  return motionAbout(refined * target_centre, targetMotion(*tracked, tracked_then, target_centre)) * refined;
}

RefinementPolicy::RefinementPolicy(const RefinementPolicyOptions& options, const Eigen::Vector3d& target_centre,
                                   Request request)
  : options_(options), target_centre_(target_centre), request_(std::move(request))
{
  options_.validate();
  waiting_.set_capacity(options_.mode == RefinementMode::EVERY_FRAME ? options_.queue_size : 1);
}

void RefinementPolicy::onExposure(const TrackedExposure& exposure, std::int64_t now)
{
  if (!anchor_)
  {
    anchor_ = exposure.room_from_patient;
  }
  exposures_since_request_ = std::min(exposures_since_request_ + 1, options_.every_n);
  const bool every_frame = options_.mode == RefinementMode::EVERY_FRAME;
  if ((pending_ && !every_frame) || !due(exposure, now))
  {
    return;
  }
  skipped_ += waiting_.full() ? 1 : 0;
  waiting_.push_back(exposure);
  next(now);
  if (!every_frame)
  {
    waiting_.clear();  // Later exposures are as good.
  }
}

void RefinementPolicy::next(std::int64_t now)
{
  if (pending_ || waiting_.empty())
  {
    return;
  }
  const TrackedExposure& exposure = waiting_.front();
  const RefinementRequest request{ next_id_++, exposure.stamp, exposure.room_from_patient };
  exposures_since_request_ = 0;
  not_before_ = now + static_cast<std::int64_t>(1e9 * options_.timeout);
  if (!request_(request))
  {
    ++unheard_;
    return;
  }
  pending_ = Pending{ request.id, now, exposure };
  waiting_.pop_front();
  demanded_ = false;
  ++requests_;
}

bool RefinementPolicy::due(const TrackedExposure& exposure, std::int64_t now) const
{
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
             (!exposure.measured || drift.tail<3>().norm() > options_.drift ||
              drift.head<3>().norm() > options_.drift_rotation || exposure.disagreement > options_.drift_residual);
    }
    case RefinementMode::NEVER:
    case RefinementMode::ON_DEMAND:
      break;
  }
  return false;
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

std::optional<Refinement> RefinementPolicy::onReply(const RefinementReply& reply)
{
  if (!pending_ || reply.id != pending_->id)
  {
    last_refusal_ = compose("the answer to request ", reply.id, " is for none under way");
    last_refusal_contradicts_ = false;
    return std::nullopt;
  }
  const TrackedExposure exposure = pending_->exposure;
  pending_.reset();
  std::string reason = fault(reply);
  last_refusal_contradicts_ = false;
  // Where there is no tracked pose, the registration's own word has to do.
  if (reason.empty() && exposure.measured)
  {
    reason = contradiction(reply, exposure);
    last_refusal_contradicts_ = !reason.empty();
  }
  if (!reason.empty())
  {
    ++refused_;
    last_refusal_ = std::move(reason);
    return std::nullopt;
  }
  ++accepted_;
  anchor_ = reply.room_from_patient;
  not_before_ = 0;
  const auto tracked = exposure.measured ? std::make_optional(exposure.room_from_patient) : std::nullopt;
  const Refinement refinement{ exposure.stamp, tracked, reply.room_from_patient, reply.covariance };
  for (TrackedExposure& waiting : waiting_)
  {
    if (!waiting.measured)
    {
      waiting.room_from_patient = refinement.refined;
    }
    else if (tracked)
    {
      waiting.room_from_patient = refinement.carry(waiting.room_from_patient, target_centre_);
    }
  }
  return refinement;
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

  if (!(reply.similarity >= options_.min_similarity) || !(reply.similarity >= reply.seed_similarity))
  {
    return compose("the similarity is ", reply.similarity, ", expected at least ", options_.min_similarity,
                   " and the seed's ", reply.seed_similarity);
  }
  return std::string();
}

std::string RefinementPolicy::contradiction(const RefinementReply& reply, const TrackedExposure& exposure) const
{
  const Twist correction = targetMotion(exposure.room_from_patient, reply.room_from_patient, target_centre_);
  if (correction.tail<3>().norm() > options_.max_correction ||
      correction.head<3>().norm() > options_.max_correction_rotation)
  {
    return compose("the correction is ", correction.tail<3>().norm(), " mm and ", correction.head<3>().norm(),
                   " rad, expected at most ", options_.max_correction, " mm and ", options_.max_correction_rotation,
                   " rad");
  }
  const PoseCovariance covariance = covarianceAt(target_centre_, exposure.room_from_patient, exposure.covariance) +
                                    covarianceAt(target_centre_, reply.room_from_patient, reply.covariance);
  Eigen::Matrix<double, 6, 1> difference;
  difference << correction.tail<3>(), correction.head<3>();
  const Eigen::LLT<PoseCovariance> cholesky(covariance);
  const double chi_square = difference.dot(cholesky.solve(difference));
  const double bound =
      boost::math::quantile(boost::math::complement(boost::math::chi_squared(6), options_.significance));
  if (cholesky.info() != Eigen::Success || !(chi_square <= bound))
  {
    return compose(
        "the refinement contradicts the tracked pose: chi-square of "
        "the correction is ",
        chi_square, " with 6 degrees of freedom, expected at most ", bound);
  }
  return std::string();
}

void RefinementPolicy::reset()
{
  waiting_.clear();
  pending_.reset();
  anchor_.reset();
  exposures_since_request_ = 0;
  demanded_ = false;
  not_before_ = 0;
}
}  // namespace xray_tracking
