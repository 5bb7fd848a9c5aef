#include "xray_tracking_motion_estimation/motion_monitor.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/Eigenvalues>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
/// Measured on patients: TRE below 1.2 mm in 32 %, below 2.4 mm in 82 % of the frames [mm].
constexpr double kTissueSigma = 1.0;

constexpr int kAstrayExposures = 2;              ///< in a row, before a region is learnt anew
constexpr std::int64_t kProposals = 1000000000;  ///< between two proposals for a view [ns]
constexpr double kAstray = 1.0;                  ///< from where a registration sees the target [mm]

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

const char* motionStateName(MotionState state)
{
  static const char* const kNames[] = { "OK",           "WAITING",   "LOST",        "INCONSISTENT",
                                        "NO_REFERENCE", "BAD_STAMP", "UNREGISTERED" };
  return kNames[static_cast<std::size_t>(state)];
}

const char* poseMethodName(PoseMethod method)
{
  static const char* const kNames[] = { "tracking", "registration", "tracking_and_registration" };
  return kNames[static_cast<std::size_t>(method)];
}

PoseMethod poseMethodFromName(const std::string& name)
{
  for (const PoseMethod method :
       { PoseMethod::TRACKING, PoseMethod::REGISTRATION, PoseMethod::TRACKING_AND_REGISTRATION })
  {
    if (name == poseMethodName(method))
    {
      return method;
    }
  }
  throw std::invalid_argument("method is '" + name + "', expected tracking, registration or tracking_and_registration");
}

MotionMonitorOptions::MotionMonitorOptions()
{
  tracks.estimation.tissue_sigma = kTissueSigma;
}

void MotionMonitorOptions::derive()
{
  requireOption(rigid_sigma > 0.0 && std::isfinite(rigid_sigma), "consistency/rigid_sigma", rigid_sigma,
                "a number > 0 mm");
  requireOption(deadline >= 0.0 && deadline <= 10.0, "pose/deadline", deadline, "0 to 10 s");
  requireOption(method != PoseMethod::REGISTRATION || deadline > 0.0, "pose/deadline", deadline,
                "a number > 0 s where method is registration: no answer comes at once");
  requireOption(method == PoseMethod::TRACKING || refinement.mode != RefinementMode::NEVER, "refinement/mode",
                "'never'", std::string("another one where method is ") + poseMethodName(method));
  tracks.consistency.floor_sigma = tracks.estimation.floor_sigma;
  tracks.rigid_consistency = tracks.consistency;
  tracks.rigid_consistency.floor_sigma = rigid_sigma;
  tracks.rigid_consistency.persistent_sigma = 0.0;
  prediction.tissue_sigma = tracks.estimation.tissue_sigma;
  gate.verification.registration = refinement.mode != RefinementMode::NEVER;
  refinement.target_speed = tracks.target_speed;
}

MotionMonitor::MotionMonitor(const MotionMonitorOptions& options, const RigidTransform& room_from_patient,
                             const Eigen::Vector3d& target_centre)
  : options_(options),
    initial_pose_(room_from_patient),
    target_centre_(target_centre),
    tracks_(options.tracks, room_from_patient, target_centre),
    predictor_(options.prediction, target_centre),
    refinement_(options.refinement, target_centre),
    gate_(options.gate),
    astray_(options.tracks.views.size())
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
  took_ = { now - asked_, took_[0] };
  RefinementPolicy::Judgement judgement = refinement_.judge(reply);
  const bool of_current = current_ && current_->asked == reply.id;
  if (judgement.refinement)
  {
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
    contradiction_ = judgement.reason;
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
    gate_.refused(why.str(), false);
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
  astray_.assign(astray_.size(), {});
  contradiction_.clear();
  last_seen_.reset();
  unconfirmed_ = doubt;
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

std::optional<RegionProposal> MotionMonitor::takeProposal()
{
  if (proposals_.empty())
  {
    return std::nullopt;
  }
  const RegionProposal proposal = proposals_.front();
  proposals_.pop_front();
  return proposal;
}

void MotionMonitor::advance(std::int64_t now)
{
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
  current_.emplace();
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

  const auto any = [&](const auto& holds)
  {
    const auto view = std::find_if(exposure.views.begin(), exposure.views.end(),
                                   [&](const std::optional<TrackedView>& v) { return v && holds(*v); });
    return view == exposure.views.end()
               ? std::string()
               : options_.tracks.views[static_cast<std::size_t>(view - exposure.views.begin())];
  };
  // What shows nothing, or what an earlier exposure showed, is no evidence of where the patient is.
  const std::string blind = any([](const TrackedView& view) { return view.state == RegionState::BLIND; });
  const std::string unable =
      any([](const TrackedView& view) { return view.state == RegionState::UNTRAINED && !view.fault.empty(); });
  if (options_.refinement.mode == RefinementMode::NEVER)
  {
    current_->not_registered = "no registration is asked for";
  }
  else if (!blind.empty())
  {
    current_->not_registered = blind + " is blind";
  }
  else if (current_->tracks.state == MotionState::WAITING && unable.empty())
  {
    current_->not_registered = current_->tracks.reason;
  }
  else
  {
    if (gate_.verification().due())
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
  contradiction_.clear();
  unconfirmed_.clear();
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
  gate_.refined(refinement.stamp, correction, rotation(last_pose_->second));
  if (current_ && current_->exposure.fault == MotionState::OK)
  {
    estimate();  // its tracks count from elsewhere now
  }
}

void MotionMonitor::proposeRegions()
{
  const TrackedExposure& exposure = current_->exposure;
  for (std::size_t i = 0; i < exposure.views.size(); ++i)
  {
    const std::optional<TrackedView>& view = exposure.views[i];
    Astray& astray = astray_[i];
    std::optional<cv::Rect> region;
    if (view && !view->region.empty() && current_->refinement)
    {
      region = tracks_.regionAt(i, current_->refinement->refined);
    }
    const bool lost = view && view->state == RegionState::LOST;
    const bool elsewhere = region && current_->tracks.state == MotionState::INCONSISTENT && followsOther(i, *region);
    astray.exposures = lost || elsewhere ? astray.exposures + 1 : 0;
    if (region && astray.exposures >= kAstrayExposures &&
        (!astray.proposed || exposure.stamp - *astray.proposed >= kProposals))
    {
      const Eigen::Vector2i& size = tracks_.geometries()[i].imageSize();
      const cv::Rect inside = *region & cv::Rect(0, 0, size.x(), size.y());
      if (2 * inside.area() > region->area())
      {
        astray.proposed = exposure.stamp;
        proposals_.push_back({ i, inside });
      }
    }
  }
}

bool MotionMonitor::followsOther(std::size_t view, const cv::Rect& region) const
{
  const TrackedView& tracked = *current_->exposure.views[view];
  if (tracked.state != RegionState::TRACKING && tracked.state != RegionState::DEGRADED)
  {
    return false;
  }
  const ProjectionGeometry& geometry = tracks_.geometries()[view];
  const cv::Point shift = region.tl() - tracked.region.tl();
  const double pixels = (Eigen::Vector2d(shift.x, shift.y) - tracked.track.displacement).norm();
  const Eigen::Vector3d target = current_->refinement->refined * target_centre_;
  return pixels * geometry.pixelPitch().mean() > kAstray * geometry.magnification(target);
}

void MotionMonitor::decide(std::int64_t now)
{
  const TrackedExposure& exposure = current_->exposure;
  MotionDecision decision = decisionOf(now);
  proposeRegions();
  if (current_->tracks.state == MotionState::OK || decision.state == MotionState::OK)
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
    predictor_.add(exposure.stamp, decision.room_from_patient, decision.pose_covariance);
    last_pose_ = { exposure.stamp, decision.room_from_patient };
    last_was_registered_ = registered;
  }
  tellGate(decision, now);
  decisions_.push_back(std::move(decision));
  if (current_->asked)
  {
    late_ = std::move(current_->exposure);
  }
  current_.reset();
}

MotionDecision MotionMonitor::decisionOf(std::int64_t now) const
{
  const TrackedExposure& exposure = current_->exposure;
  MotionDecision decision;
  decision.stamp = exposure.stamp;
  decision.cpu_seconds = exposure.cpu_seconds;
  decision.wall_seconds = exposure.wall_seconds + 1e-9 * static_cast<double>(now - exposure.arrival);
  decision.state = current_->tracks.state;
  decision.reason = current_->tracks.reason;
  decision.views_differ = current_->tracks.views_differ;
  if (const std::optional<MotionEstimate>& estimate = current_->tracks.estimate)
  {
    decision.room_from_patient = estimate->room_from_patient;
    decision.pose_covariance = estimate->pose_covariance;
    decision.displacement_covariance = estimate->covariance.topLeftCorner<3, 3>();
    decision.displacement = displacement(estimate->room_from_patient);
    decision.disagreement = estimate->disagreement;
    decision.chi_square = estimate->chi_square;
    decision.degrees_of_freedom = estimate->degrees_of_freedom;
    decision.views = static_cast<int>(estimate->residuals.size());
  }
  if (current_->refinement)
  {
    const Refinement& refinement = *current_->refinement;
    decision.state = MotionState::OK;
    decision.reason.clear();
    decision.source = PoseSource::REGISTERED;
    decision.room_from_patient = refinement.refined;
    decision.pose_covariance = refinement.covariance;
    decision.displacement_covariance =
        covarianceAt(target_centre_, refinement.refined, refinement.covariance).topLeftCorner<3, 3>();
    decision.displacement = displacement(refinement.refined);
    return decision;
  }
  decision.not_registered =
      options_.method == PoseMethod::TRACKING ? "tracked poses are published" : current_->not_registered;
  if (decision.state != MotionState::OK)
  {
    if (options_.method != PoseMethod::TRACKING && decision.reason != decision.not_registered)
    {
      decision.reason += "; not registered: " + decision.not_registered;
    }
  }
  else if (options_.method == PoseMethod::REGISTRATION)
  {
    decision.state = MotionState::UNREGISTERED;
    decision.reason = decision.not_registered;
  }
  else if (!contradiction_.empty() && options_.method == PoseMethod::TRACKING_AND_REGISTRATION)
  {
    decision.state = MotionState::INCONSISTENT;
    decision.reason = "registration and tracks contradict each other: " + contradiction_;
  }
  else if (!unconfirmed_.empty())
  {
    decision.state = MotionState::NO_REFERENCE;
    decision.reason = unconfirmed_;
  }
  else
  {
    decision.source = PoseSource::TRACKED;
  }
  return decision;
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
    exposure.rotation = rotation(decision.room_from_patient);
    exposure.rotation_variance = largestEigenvalue(decision.pose_covariance.bottomRightCorner<3, 3>());
    for (std::size_t i = 0; !exposure.registered && i < options_.tracks.views.size(); ++i)
    {
      if (tracks_.doubt(i).state == MotionState::OK && current_->exposure.views[i]->state == RegionState::DEGRADED)
      {
        exposure.doubt = options_.tracks.views[i] + " is degraded: much of its region does not look like the template";
      }
    }
  }
  gate_.update(exposure);
}

Eigen::Vector3d MotionMonitor::displacement(const RigidTransform& room_from_patient) const
{
  return room_from_patient * target_centre_ - initial_pose_ * target_centre_;
}

double MotionMonitor::rotation(const RigidTransform& room_from_patient) const
{
  return rotationAngle(room_from_patient * initial_pose_.inverse());
}
}  // namespace xray_tracking
