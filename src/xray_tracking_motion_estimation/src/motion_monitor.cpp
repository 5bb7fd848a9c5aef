#include "xray_tracking_motion_estimation/motion_monitor.h"

#include <algorithm>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/Eigenvalues>

namespace xray_tracking
{
namespace
{
double largestEigenvalue(const Eigen::Matrix3d& covariance)
{
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()[2];
}

GateReason gateFault(MotionState state)
{
  switch (state)
  {
    case MotionState::OK:
      return GateReason::NONE;
    case MotionState::INCONSISTENT:
      return GateReason::INCONSISTENT;
    case MotionState::BAD_STAMP:
      return GateReason::BAD_STAMP;
    default:
      return GateReason::NOT_MEASURED;
  }
}
}  // namespace

MotionMonitor::MotionMonitor(const MotionMonitorOptions& options, const RigidTransform& room_from_patient,
                             const Eigen::AlignedBox3d& target_box)
  : options_(options),
    target_centre_(target_box.center()),
    tracks_(options.tracks, room_from_patient, target_centre_),
    predictor_(options.prediction, target_centre_),
    refinement_(options.refinement, target_centre_),
    gate_(options.gate),
    rules_(options.method, room_from_patient, target_centre_),
    proposer_(options.tracks.views.size(), target_box)
{
}

void MotionMonitor::onExposure(TrackedExposure exposure, std::int64_t now)
{
  waiting_.push_back(std::move(exposure));
  advance(now);
}

void MotionMonitor::onReply(const RefinementReply& reply, std::int64_t now)
{
  if (refinement_.pending() != reply.id)
  {
    return;
  }
  if (claim_ && claim_->request == reply.id)
  {
    endClaim(reply);
    advance(now);
    return;
  }
  took_ = { now - asked_, took_[0] };
  RefinementPolicy::Judgement judgement = refinement_.judge(reply);
  const bool of_current = current_ && current_->asked == reply.id;
  if (judgement.refinement)
  {
    judgement.refinement->hidden = clarity_.hidden(reply.view_similarities, judgement.refinement->stamp);
    if (of_current)
    {
      judgement.reason = apply(*judgement.refinement, current_->exposure);
      current_->refinement = judgement.reason.empty() ? judgement.refinement : std::nullopt;
    }
    else
    {
      applyLate(*judgement.refinement);
    }
  }
  else if (judgement.verdict == RefinementVerdict::CONTRADICTS)
  {
    rules_.contradict(judgement.reason);
    gate_.refused(judgement.reason, true);
  }
  else if (judgement.verdict == RefinementVerdict::REFUSED)
  {
    gate_.refused(judgement.reason, false);
  }
  if (of_current)
  {
    current_->asked.reset();
    current_->not_registered = judgement.reason;
  }
  advance(now);
}

void MotionMonitor::onTime(std::int64_t now)
{
  if (refinement_.tick(now))
  {
    std::ostringstream why;
    why << "no answer within " << options_.refinement.timeout << " s";
    if (claim_ && claim_->request)
    {
      refuseClaim(why.str());
    }
    else
    {
      gate_.refused(why.str(), false);
    }
  }
  advance(now);
  gate_.tick(now);
}

std::int64_t MotionMonitor::deadline() const
{
  return current_->exposure.arrival + static_cast<std::int64_t>(1e9 * options_.deadline);
}

std::optional<std::int64_t> MotionMonitor::wakeAt() const
{
  return current_ ? std::optional(deadline()) : std::nullopt;
}

void MotionMonitor::restart(const std::string& doubt)
{
  tracks_.restart();
  last_pose_.reset();
  last_was_registered_ = false;
  predictor_.reset();
  refinement_.reset();
  gate_.reset("exposures start again");
  waiting_.clear();
  current_.reset();
  request_.reset();
  late_.reset();
  latest_.reset();
  if (claim_)
  {
    refuseClaim("exposures start again");
  }
  claim_refusal_.clear();
  took_ = {};
  last_seen_.reset();
  proposer_.restart();
  clarity_.restart();
  rules_.restart(doubt);
  if (!doubt.empty())
  {
    gate_.doubt(doubt);
  }
}

std::optional<MotionDecision> MotionMonitor::takeDecision()
{
  if (decisions_.empty())
  {
    return std::nullopt;
  }
  MotionDecision decision = std::move(decisions_.front());
  decisions_.pop_front();
  return decision;
}

std::optional<RefinementRequest> MotionMonitor::takeRequest()
{
  return std::exchange(request_, std::nullopt);
}

void MotionMonitor::advance(std::int64_t now)
{
  askClaimed(now);
  while (current_ || !waiting_.empty())
  {
    if (!current_)
    {
      begin(now);
    }
    if (current_->due)
    {
      ask(now);
    }
    if (waits(now))
    {
      return;
    }
    decide(now);
  }
}

void MotionMonitor::estimate()
{
  current_->tracks = tracks_.estimate(current_->exposure);
  if (!current_->tracks.start_doubt.empty())
  {
    gate_.doubt(current_->tracks.start_doubt);
  }
}

void MotionMonitor::begin(std::int64_t now)
{
  current_ = Current();
  current_->exposure = std::move(waiting_.front());
  waiting_.pop_front();
  const TrackedExposure& exposure = current_->exposure;
  if (exposure.fault != MotionState::OK)
  {
    current_->tracks.state = exposure.fault;
    current_->tracks.reason = current_->not_registered = exposure.text;
    return;
  }
  last_seen_ = last_seen_.value_or(exposure.stamp);
  estimate();

  // What shows nothing, or what an earlier exposure showed, is no evidence of where the patient is; two others are.
  std::string blind;
  std::size_t seeing = 0;
  bool unable = false;
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    const bool is_blind = view && view->state == RegionState::BLIND;
    current_->without.push_back(is_blind || !view);
    seeing += current_->without.back() ? 0 : 1;
    unable = unable || (view && view->state == RegionState::UNTRAINED && !view->fault.empty());
    if (is_blind && blind.empty())
    {
      blind = options_.tracks.views[i] + " is blind";
    }
  }
  if (seeing < 2)
  {
    current_->without.assign(exposure.views.size(), false);
  }
  if (options_.refinement.mode == RefinementMode::NEVER)
  {
    current_->not_registered = "no registration is asked for";
  }
  else if (!blind.empty() && seeing < 2)
  {
    current_->not_registered = blind;
  }
  else if (current_->tracks.state == MotionState::WAITING && !unable)
  {
    current_->not_registered = current_->tracks.reason;
    current_->untrained = true;
  }
  else
  {
    if (gate_.verification().due() || proposer_.learning())
    {
      refinement_.demand();  // whatever the mode
    }
    current_->due = refinement_.due(seed(), now);
    current_->not_registered = "no registration was due";
  }
}

RefinementSeed MotionMonitor::seed() const
{
  const std::optional<MotionEstimate>& estimate = current_->tracks.estimate;
  const bool tracked = current_->tracks.state == MotionState::OK;
  const std::int64_t stamp = current_->exposure.stamp;
  RefinementSeed seed{ stamp,
                       last_pose_ ? last_pose_->second : tracks_.reference(),
                       PoseCovariance::Zero(),
                       estimate ? estimate->disagreement_mm : 0.0,
                       tracked,
                       1e-9 * static_cast<double>(stamp - *last_seen_) };
  if (tracked)
  {
    seed.room_from_patient = estimate->room_from_patient;
    seed.covariance = estimate->pose_covariance;
  }
  return seed;
}

void MotionMonitor::ask(std::int64_t now)
{
  if (refinement_.pending())
  {
    current_->not_registered = "the registration is still at an earlier exposure";
    return;
  }
  // Else it would make the next one late, too, and that one the one after it.
  if (!waiting_.empty() && now + std::min(took_[0], took_[1]) > deadline())
  {
    current_->due = false;
    current_->not_registered = "the registration is behind, and turns to a later exposure";
    return;
  }
  asked_ = now;
  request_ = refinement_.ask(seed(), !gate_.verification().verified(), now);
  if (options_.method == PoseMethod::REGISTRATION && current_->tracks.state == MotionState::OK && last_pose_)
  {
    request_->room_from_patient = last_pose_->second;
  }
  request_->without = current_->without;
  current_->asked = request_->id;
  current_->due = false;
  std::ostringstream why;
  why << "no answer within " << options_.deadline << " s";
  current_->not_registered = why.str();
}

bool MotionMonitor::waits(std::int64_t now) const
{
  const bool open = current_->due || (current_->asked && refinement_.pending() == current_->asked);
  return options_.method != PoseMethod::TRACKING && open && now < deadline();
}

std::string MotionMonitor::apply(const Refinement& refinement, const TrackedExposure& exposure)
{
  try
  {
    tracks_.accept(refinement, exposure);
  }
  catch (const std::invalid_argument& error)
  {
    gate_.refused(error.what(), false);
    return error.what();
  }
  rules_.confirm();
  return std::string();
}

void MotionMonitor::applyLate(const Refinement& refinement)
{
  if (tracks_.empty())
  {
    // Nothing was measured so far: the first templates are still those of the initial pose.
    last_pose_ = { refinement.stamp, refinement.refined };
    last_seen_ = std::max(*last_seen_, refinement.stamp);
    return;
  }
  if (!apply(refinement, *late_).empty())
  {
    return;
  }
  tracks_.add(*late_, refinement.refined, true);
  Eigen::Vector3d correction = Eigen::Vector3d::Zero();
  if (!last_pose_ || last_pose_->first < refinement.stamp)
  {
    last_pose_ = { refinement.stamp, refinement.refined };
    last_seen_ = std::max(*last_seen_, refinement.stamp);
  }
  else if (refinement.tracked)
  {
    const RigidTransform before = last_pose_->second;
    last_pose_->second = refinement.carry(before, target_centre_);
    predictor_.correct(before, last_pose_->second);
    correction = last_pose_->second * target_centre_ - before * target_centre_;
  }
  gate_.refined(refinement.stamp, correction, rules_.rotation(last_pose_->second));
  if (current_ && current_->exposure.fault == MotionState::OK)
  {
    estimate();  // its tracks count from elsewhere now
  }
}

void MotionMonitor::decide(std::int64_t now)
{
  const TrackedExposure& exposure = current_->exposure;
  MotionDecision decision = rules_.decide(exposure, current_->tracks, current_->refinement, current_->not_registered);
  decision.wall_seconds += 1e-9 * static_cast<double>(now - exposure.arrival);
  proposer_.look(exposure, current_->tracks, current_->refinement ? &*current_->refinement : nullptr, tracks_);
  const bool at_start = current_->untrained && tracks_.empty() && !last_pose_;
  if (current_->tracks.state == MotionState::OK || decision.state == MotionState::OK || at_start)
  {
    last_seen_ = exposure.stamp;
  }
  if (decision.state == MotionState::OK)
  {
    const bool registered = decision.source == PoseSource::REGISTERED;
    tracks_.add(exposure, decision.room_from_patient, registered);
    if (registered && current_->refinement->tracked && !last_was_registered_)
    {
      predictor_.correct(*current_->refinement->tracked, decision.room_from_patient);
    }
    predictor_.add(exposure.stamp, decision.room_from_patient, decision.pose_covariance, decision.tissue_variance);
    last_pose_ = { exposure.stamp, decision.room_from_patient };
    last_was_registered_ = registered;
  }
  if (last_pose_)
  {
    proposer_.place(exposure, *last_pose_, tracks_);
  }
  tellGate(decision, now);
  decisions_.push_back(std::move(decision));
  if (current_->asked)
  {
    late_ = exposure;
  }
  if (exposure.fault == MotionState::OK)
  {
    latest_ = Decided{ std::move(current_->exposure), std::move(current_->without) };
  }
  current_.reset();
}

void MotionMonitor::tellGate(const MotionDecision& decision, std::int64_t now)
{
  GateExposure exposure;
  exposure.stamp = decision.stamp;
  exposure.arrival = now;
  exposure.delay = current_->exposure.age + now - current_->exposure.arrival;
  exposure.text = decision.reason;
  exposure.fault = gateFault(decision.state);
  if (decision.state == MotionState::OK)
  {
    exposure.registered = decision.source == PoseSource::REGISTERED;
    exposure.displacement = decision.displacement;
    exposure.covariance = decision.displacement_covariance;
    exposure.rotation = rules_.rotation(decision.room_from_patient);
    exposure.rotation_variance = largestEigenvalue(decision.pose_covariance.bottomRightCorner<3, 3>());
    exposure.doubt = exposure.registered ? doubtOfRegistered() : doubtOfTracked();
  }
  gate_.update(exposure);
}

std::string MotionMonitor::doubtOfRegistered() const
{
  const std::vector<std::string>& names = options_.tracks.views;
  std::string hidden;
  std::size_t seeing = 0;
  for (std::size_t i = 0; i < names.size(); ++i)
  {
    hidden = tracks_.isHidden(i) ? names[i] : hidden;
    seeing += tracks_.isHidden(i) || current_->without[i] ? 0 : 1;
  }
  if (!hidden.empty() && seeing < 2)
  {
    return "registered, but fewer than two views show the target: something hides it from " + hidden;
  }
  // Either tracks are wrong or views are of different moments, which a registration need not show.
  return current_->tracks.state == MotionState::INCONSISTENT
             ? "registered, but the tracks contradict each other: " + current_->tracks.reason
             : std::string();
}

std::string MotionMonitor::doubtOfTracked() const
{
  const std::vector<std::string>& names = options_.tracks.views;
  for (std::size_t i = 0; i < names.size(); ++i)
  {
    if (tracks_.doubt(i).state == MotionState::OK && current_->exposure.views[i]->state == RegionState::DEGRADED)
    {
      return names[i] + " is degraded: much of its region does not look like the template";
    }
  }
  return std::string();
}
}  // namespace xray_tracking
