#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

#include <algorithm>
#include <chrono>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <xray_tracking_msgs/PatientMotion.h>

#include "motion_messages.h"
#include "tracked_view_message.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/stamp_policy.h"
#include "xray_tracking_core/stopwatch.h"
#include "xray_tracking_motion_estimation/bone_shape.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using RefinePose = xray_tracking_msgs::RefinePose;

/// A stamp may be ahead by what two computers' clocks usually differ. Messages of a played bag are ahead of the last
/// tick of its clock by up to a tick: 10 ms, times the playback's speed, which may be a hundred [ns].
constexpr std::int64_t kMaxAhead = 5000000;
constexpr std::int64_t kClockTick = 1000000000;

/// A region is learnt within a second, on the next exposure, or not at all, as where the tracker hangs: the next
/// proposal is to find another chance [s].
const ros::WallDuration kTrainTimeout(5.0);

/// A recording that is played again without its clock is told from old exposures that come once more [ns].
constexpr std::int64_t kRestartConfirmed = 1000000000;

std::int64_t nanosecondsFromSeconds(double seconds)
{
  return static_cast<std::int64_t>(1e9 * seconds);
}

std::int64_t steadyNanoseconds()
{
  return static_cast<std::int64_t>(ros::SteadyTime::now().toNSec());
}

}  // namespace

MotionEstimationRos::MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh),
    pnh_(pnh),
    idle_gate_(BeamGateOptions()),
    started_(ros::Time::now()),
    tf_listener_(tf_buffer_, nh_),
    gate_publisher_(nh_),
    updater_(nh_, pnh_, pnh_.getNamespace())
{
  updater_.setHardwareID("none");
  updater_.add("motion", this, &MotionEstimationRos::diagnose);
  try
  {
    start();
  }
  catch (const std::exception& error)
  {
    views_.clear();
    configuration_fault_ = error.what();
    idle_gate_.reset(configuration_fault_);
    ROS_FATAL_STREAM(pnh_.getNamespace() << " is idle: " << configuration_fault_);
  }
  watchdog_ =
      nh_.createSteadyTimer(ros::WallDuration(BeamGatePublisher::kPeriod), &MotionEstimationRos::watchdogCb, this);
  report_timer_ = nh_.createSteadyTimer(ros::WallDuration(1.0), &MotionEstimationRos::reportCb, this);
}

MotionEstimationRos::~MotionEstimationRos()
{
  // A nodelet's callbacks may be running in another thread: this waits for them, before any member goes. What any of
  // them may start comes last.
  if (registration_)
  {
    registration_->shutdown();
  }
  report_timer_.stop();
  watchdog_.stop();
  refine_server_.shutdown();
  restart_server_.shutdown();
  hold_beam_server_.shutdown();
  operator_subscriber_.shutdown();
  for (View& view : views_)
  {
    view.camera_info_subscriber.shutdown();
    view.tracked_region_subscriber.shutdown();
  }
  // After what may have an outcome for it; its own callbacks may start the timer once more.
  deadline_timer_.stop();
  alignment_server_.reset();
  for (View& view : views_)
  {
    if (view.trainer)
    {
      view.trainer->shutdown();
    }
  }
  deadline_timer_.stop();
  if (keeping_.valid())
  {
    keeping_.wait();
  }
  // A nodelet may be unloaded because its loader has died; then another one takes its place.
  if (restart_file_ && !ros::ok())
  {
    restart_file_->remove();
  }
}

void MotionEstimationRos::start()
{
  parameters_ = readMotionEstimationParameters(ParameterReader(pnh_));
  const PoseVerificationOptions& verification = parameters_.monitor.gate.verification;
  ROS_WARN_STREAM_COND(verification.registration && verification.initial_pose_verified,
                       "gate/initial_pose_verified counts for nothing while refinement/mode is not never: the "
                       "registration has to confirm the initial pose; leave it out");
  setup_ = loadTreatmentSetup(parameters_.setup_file);
  shape_ = std::async(parameters_.bone_shape ? std::launch::async : std::launch::deferred,
                      [setup = setup_, bone = parameters_.bone_shape]
                      { return bone ? boneShape(setup) : TargetShape::isotropic(setup.targetCentre()); });
  monitor_.emplace(parameters_.monitor, setup_.room_from_patient, setup_.target_box);
  if (parameters_.keep_for_restart)
  {
    readRestartFile();
  }
  motion_publisher_ = nh_.advertise<PatientMotion>("patient_motion", 100);
  pose_publisher_ = nh_.advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 100);
  prediction_publisher_ = nh_.advertise<geometry_msgs::PoseWithCovarianceStamped>("predicted_pose", 100);
  deadline_timer_ = nh_.createSteadyTimer(ros::WallDuration(1.0), &MotionEstimationRos::deadlineCb, this, true, false);
  if (parameters_.monitor.refinement.mode != RefinementMode::NEVER)
  {
    registration_ = std::make_unique<ServiceCaller<RefinePose>>(
        nh_, "refine_pose",
        [this](const std::optional<RefinePose::Response>& response, const std::string& why)
        {
          monitor_->onReply(replyFrom(asked_, response, why, compared_, parameters_.monitor.tracks.views),
                            steadyNanoseconds());
          const std::optional<RefinementRequest> waiting = std::exchange(waiting_, std::nullopt);
          if (waiting && monitor_->refinement().pending() == waiting->id)
          {
            ask(*waiting);
          }
          settle();
        });
  }
  const std::vector<std::string>& detectors = parameters_.monitor.tracks.views;
  assembler_.emplace(detectors.size(), parameters_.queue_size,
                     nanosecondsFromSeconds(parameters_.monitor.tracks.pairing_tolerance),
                     StampPolicy::Options{ ros::Time::isSimTime() ? kClockTick : kMaxAhead, kRestartConfirmed });
  geometry_.emplace(detectors, tf_buffer_);
  views_.resize(detectors.size());
  for (std::size_t i = 0; i < detectors.size(); ++i)
  {
    views_[i].name = detectors[i];
  }
  // Callbacks of a nodelet may come in another thread from here on.
  restart_server_ = pnh_.advertiseService("restart", &MotionEstimationRos::restartCb, this);
  hold_beam_server_ = pnh_.advertiseService("hold_beam", &MotionEstimationRos::holdBeamCb, this);
  if (registration_)
  {
    refine_server_ = pnh_.advertiseService("refine", &MotionEstimationRos::refineCb, this);
  }
  alignment_server_ = std::make_unique<AlignmentServer>(
      pnh_,
      [this](const RigidTransform& room_from_patient)
      {
        const std::string why = monitor_->claim(room_from_patient, steadyNanoseconds());
        settle();
        return why;
      },
      [this] { monitor_->withdrawClaim(); });
  operator_subscriber_ = nh_.subscribe("operator_present", 1, &MotionEstimationRos::operatorPresentCb, this);
  for (std::size_t i = 0; i < detectors.size(); ++i)
  {
    subscribe(views_[i], i);
  }
}

void MotionEstimationRos::subscribe(View& view, std::size_t index)
{
  const ros::TransportHints no_delay = ros::TransportHints().tcpNoDelay();
  const boost::function<void(const sensor_msgs::CameraInfo::ConstPtr&)> camera_info_cb =
      [this, index](const sensor_msgs::CameraInfo::ConstPtr& info) { geometry_->update(index, *info); };
  view.camera_info_subscriber =
      nh_.subscribe<sensor_msgs::CameraInfo>(view.name + "/camera_info", 10, camera_info_cb, nullptr, no_delay);
  const boost::function<void(const TrackedRegion::ConstPtr&)> tracked_region_cb =
      [this, index](const TrackedRegion::ConstPtr& message) { trackedRegionCb(message, index); };
  view.tracked_region_subscriber = nh_.subscribe<TrackedRegion>(view.name + "/tracked_region", parameters_.queue_size,
                                                                tracked_region_cb, nullptr, no_delay);
  if (registration_)
  {
    view.trainer = std::make_unique<ServiceCaller<TrainRegion>>(
        nh_, view.name + "/train_region",
        [&view](const std::optional<TrainRegion::Response>& response, const std::string& why)
        {
          const bool learnt = response && response->status == TrainRegion::Response::OK;
          ROS_INFO_STREAM_COND(learnt, view.name << " has learnt its region anew where the target is");
          ROS_WARN_STREAM_COND(!learnt,
                               view.name << " has not learnt its region anew: " << (response ? response->message : why)
                                         << "; draw it by hand if this lasts");
        });
  }
}

void MotionEstimationRos::trackedRegionCb(const TrackedRegion::ConstPtr& message, std::size_t view)
{
  const Stopwatch stopwatch;
  views_[view].last_arrival = ros::SteadyTime::now();
  if (first_arrival_.isZero())
  {
    first_arrival_ = views_[view].last_arrival;
  }
  setSilent(view, false);
  first_heard_ = first_heard_.isZero() ? message->header.stamp : std::min(first_heard_, message->header.stamp);
  if (started_.isZero())
  {
    started_ = ros::Time::now();
  }
  using Outcome = ExposureAssembler<TrackedRegion::ConstPtr>::Outcome;
  const ros::Time now = ros::Time::now();
  // A clock that has not begun is no reason to take any stamp: a pose needs an age.
  const Outcome outcome = assembler_->add(view, nanosecondsFromTime(message->header.stamp), message,
                                          std::max<std::int64_t>(nanosecondsFromTime(now), 1));
  if (outcome != Outcome::COMPLETE && outcome != Outcome::FUTURE)
  {
    return;
  }
  if (assembler_->restarted())
  {
    started_ = first_heard_ = timeFromNanoseconds(assembler_->stamp());
    ROS_WARN_STREAM_THROTTLE(1.0, "exposures start again at "
                                      << started_
                                      << ": forgetting the earlier ones; unless a bag is played again, look "
                                      << "at the detectors' and this computer's clocks");
    // A bag that is played again begins with the patient where it began. A clock that was set, or old exposures that
    // are sent once more, find the patient anywhere, and the trackers learn their templates there.
    monitor_->restart(ros::Time::isSimTime()
                          ? ""
                          : "time went back: nothing has confirmed that the patient was at the initial pose again");
    before_.reset();
    // This node's own transforms of the earlier run; static ones stay.
    tf_buffer_.clear();
  }

  TrackedExposure exposure;
  exposure.stamp = assembler_->stamp();
  exposure.arrival = steadyNanoseconds();
  exposure.age = nanosecondsFromTime(now) - exposure.stamp;
  if (outcome == Outcome::FUTURE)
  {
    exposure.fault = MotionState::BAD_STAMP;
    exposure.text = "clocks differ: " + assembler_->why();
  }
  if (ros::Time::isSimTime())
  {
    exposure.age = std::max<std::int64_t>(exposure.age, 0);
  }
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const TrackedRegion::ConstPtr& region = assembler_->exposure()[i];
    exposure.views.push_back(region ? std::make_optional(trackedViewFromMsg(*region, assembler_->offset(i)))
                                    : std::nullopt);
    exposure.cpu_seconds += region ? region->cpu_time.toSec() : 0.0;
    exposure.wall_seconds = std::max(exposure.wall_seconds, region ? region->wall_time.toSec() : 0.0);
  }
  // In the order of their weight: views that have no template yet are no fault of the geometry.
  if (exposure.fault == MotionState::OK)
  {
    exposure.text = checkGeometry(exposure.stamp);
    exposure.fault = exposure.text.empty() ? MotionState::OK : MotionState::WAITING;
  }
  exposure.cpu_seconds += stopwatch.cpuSeconds();
  monitor_->tracks().heardFrom(nanosecondsFromTime(started_), nanosecondsFromTime(first_heard_));
  monitor_->onExposure(std::move(exposure), steadyNanoseconds());
  settle();
}

std::string MotionEstimationRos::checkGeometry(std::int64_t stamp)
{
  const std::string fault = geometry_->check();
  if (!fault.empty() || has_geometry_)
  {
    return fault;
  }
  if (shape_.wait_for(std::chrono::seconds(0)) == std::future_status::timeout)
  {
    return "the target's shape is being taken from " + setup_.ct_path;
  }
  try
  {
    monitor_->tracks().setGeometry(geometry_->geometries(), shape_.get());
    geometry_->accept();
    has_geometry_ = true;
    takeUp(stamp);
  }
  catch (const std::exception& error)  // of a geometry that is none, or of a CT
  {
    return error.what();
  }
  return std::string();
}

void MotionEstimationRos::setSilent(std::size_t view, bool silent)
{
  views_[view].silent = silent;
  const auto heard = std::count_if(views_.begin(), views_.end(), [](const View& v) { return !v.silent; });
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    assembler_->expect(i, heard < 2 || !views_[i].silent);
  }
}

void MotionEstimationRos::settle()
{
  while (const std::optional<MotionDecision> decision = monitor_->takeDecision())
  {
    // Of the run before, if the clock has gone back since: among this one's poses it would be one of the future.
    const std::int64_t ahead = decision->stamp - nanosecondsFromTime(ros::Time::now());
    if (decision->state == MotionState::BAD_STAMP || ahead <= StampPolicy::kJump)
    {
      publish(*decision);
    }
  }
  if (registration_ && (!monitor_->refinement().pending() || waiting_))
  {
    registration_->cancelAfter(ros::WallDuration(0.0));  // what was given up
  }
  if (const std::optional<RefinementRequest> request = monitor_->takeRequest())
  {
    ask(*request);
  }
  if (const std::optional<ClaimOutcome> outcome = monitor_->takeOutcome())
  {
    keep(true);
    alignment_server_->finish(*outcome);
  }
  while (const std::optional<RegionProposal> proposal = monitor_->takeProposal())
  {
    train(*proposal);
  }
  publishGate();
  if (const std::optional<std::int64_t> wake = monitor_->wakeAt())
  {
    deadline_timer_.stop();
    deadline_timer_.setPeriod(
        ros::WallDuration(1e-9 * static_cast<double>(std::max<std::int64_t>(*wake - steadyNanoseconds(), 100000))));
    deadline_timer_.start();
  }
}

void MotionEstimationRos::publish(const MotionDecision& decision)
{
  const PatientMotion motion = patientMotionFrom(decision, parameters_.monitor.method);
  if (decision.state == MotionState::OK)
  {
    geometry_msgs::TransformStamped transform;
    transform.header = motion.header;
    transform.child_frame_id = kPatientFrame;
    transform.transform = transformMsgFromRigid(decision.room_from_patient);
    tf_broadcaster_.sendTransform(transform);
    pose_publisher_.publish(poseStampedFrom(decision.stamp, decision.room_from_patient, decision.pose_covariance));
    publishPrediction();
  }
  if (decision.state != MotionState::BAD_STAMP)
  {
    latest_ = motion.header.stamp;
  }
  motion_publisher_.publish(motion);
  report_.add(decision);
}

void MotionEstimationRos::publishPrediction()
{
  const std::int64_t now = nanosecondsFromTime(ros::Time::now());
  const std::optional<PosePrediction> prediction =
      monitor_->predict(now + nanosecondsFromSeconds(parameters_.monitor.prediction.latency));
  if (prediction)
  {
    prediction_publisher_.publish(
        poseStampedFrom(prediction->stamp, prediction->room_from_patient, prediction->covariance));
  }
}

void MotionEstimationRos::publishGate()
{
  gate_publisher_.publish(configuration_fault_.empty() ? monitor_->gate() : idle_gate_, latest_, steadyNanoseconds());
}

void MotionEstimationRos::ask(const RefinementRequest& request)
{
  RefinePose::Request message;
  message.request.seed = poseMsgFromRigid(request.room_from_patient);
  message.request.stamp = timeFromNanoseconds(request.stamp);
  message.request.time_budget = parameters_.monitor.refinement.timeout;
  message.request.unverified = static_cast<std::uint8_t>(request.unverified);
  // Those of the setup that are not this node's, too: nobody says that they send.
  for (const ProjectionGeometry& detector : setup_.detectors)
  {
    const auto view =
        std::find_if(views_.begin(), views_.end(), [&](const View& own) { return own.name == detector.name(); });
    const auto i = static_cast<std::size_t>(view - views_.begin());
    if (i == views_.size() || (i < request.without.size() && request.without[i]))
    {
      message.request.without.push_back(detector.name());
    }
  }
  if (registration_->call(message))
  {
    asked_ = request.id;
    compared_.clear();
    for (const ProjectionGeometry& detector : setup_.detectors)
    {
      if (std::count(message.request.without.begin(), message.request.without.end(), detector.name()) == 0)
      {
        compared_.push_back(detector.name());
      }
    }
  }
  else
  {
    waiting_ = request;  // until an earlier one has been broken off
  }
}

void MotionEstimationRos::train(const RegionProposal& proposal)
{
  View& view = views_[proposal.view];
  TrainRegion::Request request;
  ROS_WARN_STREAM(view.name << " does not follow the target, and is to learn its region anew where it is");
  request.region = regionMsgFromRect(proposal.region);
  ROS_WARN_STREAM_COND(!view.trainer->call(request),
                       view.name << ": an earlier train_region is still under way, and is given up after "
                                 << kTrainTimeout.toSec() << " s");
}

bool MotionEstimationRos::refineCb(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response)
{
  response.success = static_cast<std::uint8_t>(monitor_->demandRefinement());
  response.message = "the next exposure will be refined";
  return true;
}

bool MotionEstimationRos::restartCb(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response)
{
  ROS_WARN("starts over: somebody states that the patient is at the initial pose");
  started_ = ros::Time::now();
  first_heard_ = ros::Time();
  before_.reset();
  monitor_->restart("");
  settle();
  keep(true);
  response.success = 1;
  response.message = "the next exposures count from the setup's initial pose";
  return true;
}

bool MotionEstimationRos::holdBeamCb(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response)
{
  if (request.data)
  {
    monitor_->beamHold().hold("held by an operator");
  }
  else
  {
    response.message = monitor_->beamHold().release(steadyNanoseconds());
  }
  publishGate();
  const bool kept = keep(true);
  response.success = static_cast<std::uint8_t>(response.message.empty());
  if (response.message.empty())
  {
    response.message = request.data ? "the beam is held until it is released" : "the beam is not held any more";
    response.message += kept ? "" : "; that could not be kept for the case that this node dies";
  }
  return true;
}

void MotionEstimationRos::operatorPresentCb(const std_msgs::Header::ConstPtr&)
{
  monitor_->beamHold().operatorPresent(steadyNanoseconds());
}

void MotionEstimationRos::watchdogCb(const ros::SteadyTimerEvent&)
{
  if (!configuration_fault_.empty())
  {
    publishGate();
    return;
  }
  for (View& view : views_)
  {
    if (view.trainer)
    {
      view.trainer->cancelAfter(kTrainTimeout);
    }
  }
  monitor_->onTime(steadyNanoseconds());
  settle();
  if (kept_hold_ != monitor_->beamHold().why() || kept_operator_ != monitor_->beamHold().operatorHeard())
  {
    keep(false);
  }
}

void MotionEstimationRos::deadlineCb(const ros::SteadyTimerEvent&)
{
  monitor_->onTime(steadyNanoseconds());
  settle();
}

void MotionEstimationRos::reportCb(const ros::SteadyTimerEvent&)
{
  const ros::SteadyTime now = ros::SteadyTime::now();
  const auto quiet = [&](const View& view)
  { return (now - std::max(view.last_arrival, first_arrival_)).toSec() > parameters_.view_timeout; };
  const bool any_arrives = !first_arrival_.isZero() && !std::all_of(views_.begin(), views_.end(), quiet);
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    setSilent(i, any_arrives && quiet(views_[i]));
  }
  if (configuration_fault_.empty())
  {
    report_.log(*monitor_, viewReports(), assemblyCounts());
    keep(false);
  }
  updater_.force_update();
}

std::vector<ViewReport> MotionEstimationRos::viewReports() const
{
  std::vector<ViewReport> reports;
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const View& view = views_[i];
    reports.push_back({ view.name, view.tracked_region_subscriber.getTopic(), geometry_->fault(i), view.silent });
  }
  return reports;
}

AssemblyCounts MotionEstimationRos::assemblyCounts() const
{
  return { assembler_->pending(), assembler_->incomplete(), assembler_->duplicates(), assembler_->late(),
           assembler_->future() };
}

void MotionEstimationRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  if (configuration_fault_.empty())
  {
    report_.diagnose(status, *monitor_, viewReports(), assemblyCounts());
  }
  else
  {
    status.summary(diagnostic_msgs::DiagnosticStatus::ERROR, configuration_fault_);
  }
}
}  // namespace xray_tracking
