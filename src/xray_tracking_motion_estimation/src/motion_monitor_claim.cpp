#include <algorithm>
#include <stdexcept>
#include <utility>

#include "xray_tracking_motion_estimation/motion_monitor.h"

// What MotionMonitor does about poses that people state.
namespace xray_tracking
{
std::string MotionMonitor::claim(const RigidTransform& room_from_patient, std::int64_t now)
{
  if (options_.refinement.mode == RefinementMode::NEVER)
  {
    return "no registration is asked for: refinement/mode is never";
  }
  if (!isRigid(room_from_patient))
  {
    return "the stated pose is none: expected finite numbers and a rotation";
  }
  if (claim_)
  {
    return "an earlier statement is still being looked at";
  }
  if (!latest_)
  {
    return "there is no exposure so far that could be registered";
  }
  if (const std::string fault = tracks_.faultOf(room_from_patient); !fault.empty())
  {
    return "the stated pose is of no use: " + fault;
  }
  claim_ = Claim{ room_from_patient, {}, {} };
  advance(now);
  return std::string();
}

void MotionMonitor::withdrawClaim()
{
  if (claim_ && claim_->request)
  {
    claim_->withdrawn = true;
  }
  else
  {
    claim_.reset();
  }
}

std::optional<ClaimOutcome> MotionMonitor::takeOutcome()
{
  return std::exchange(outcome_, std::nullopt);
}

void MotionMonitor::askClaimed(std::int64_t now)
{
  if (!claim_ || claim_->request || refinement_.pending())
  {
    return;
  }
  claim_->exposure = latest_->exposure;
  request_ = refinement_.askClaimed(claim_->exposure.stamp, claim_->room_from_patient, now);
  request_->without = latest_->without;
  claim_->request = request_->id;
}

void MotionMonitor::endClaim(const RefinementReply& reply)
{
  if (claim_->withdrawn)
  {
    refinement_.giveUp();
    claim_.reset();
    return;
  }
  RefinementPolicy::Judgement judgement = refinement_.judge(reply);
  if (judgement.refinement)
  {
    // All that was known before is void.
    clarity_.restart();
    judgement.refinement->hidden = clarity_.hidden(reply.view_similarities, judgement.refinement->stamp);
  }
  const std::string refusal = judgement.refinement ? applyClaim(*judgement.refinement) : judgement.reason;
  if (!refusal.empty())
  {
    refuseClaim(refusal);
    return;
  }
  outcome_ = ClaimOutcome{ "", judgement.refinement->stamp, judgement.refinement->refined };
  claim_.reset();
  claim_refusal_.clear();
}

std::string MotionMonitor::applyClaim(const Refinement& refinement)
{
  try
  {
    tracks_.accept(refinement, claim_->exposure);
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  tracks_.add(claim_->exposure, refinement.refined, true);
  last_pose_ = { refinement.stamp, refinement.refined };
  last_was_registered_ = true;
  last_seen_ = std::max(*last_seen_, refinement.stamp);
  late_.reset();
  predictor_.reset();
  proposer_.restart();
  proposer_.stated(refinement.stamp);
  rules_.confirm();
  gate_.stated(refinement.stamp, rules_.displacement(refinement.refined), rules_.rotation(refinement.refined),
               claim_refusal_);
  if (current_ && current_->exposure.fault == MotionState::OK)
  {
    estimate();  // its tracks count from elsewhere now
  }
  return std::string();
}

void MotionMonitor::refuseClaim(const std::string& why)
{
  if (!claim_->withdrawn)
  {
    claim_refusal_ = why;
    outcome_ = ClaimOutcome{ why, claim_->exposure.stamp, RigidTransform::Identity() };
  }
  claim_.reset();
}
}  // namespace xray_tracking
