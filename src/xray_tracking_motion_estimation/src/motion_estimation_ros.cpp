#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

#include <algorithm>
#include <sstream>
#include <stdexcept>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/stopwatch.h"
#include "xray_tracking_motion_estimation/bone_shape.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

/// Templates refer to exposures of the last seconds; the reference in use is kept apart.
constexpr std::size_t kHistoryCapacity = 1000;

/// A stamp may be ahead by what two computers' clocks usually differ [ns].
constexpr std::int64_t kMaxAhead = 5000000;

/// Messages of a played bag are ahead of the last tick of its clock by up to a tick: 10 ms, times the playback's speed,
/// which may be a hundred [ns].
constexpr std::int64_t kClockTick = 1000000000;

std::int64_t nanosecondsFromSeconds(double seconds)
{
  return static_cast<std::int64_t>(1e9 * seconds);
}

/// Of numbers that others have sent too: what ros::Duration does not hold would throw.
ros::Duration durationFromSeconds(double seconds)
{
  return ros::Duration(std::clamp(seconds, 0.0, 1e9));
}
}  // namespace

MotionEstimationRos::MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh),
    pnh_(pnh),
    history_(kHistoryCapacity),
    started_(ros::Time::now()),
    last_diagnosis_(ros::SteadyTime::now()),
    tf_listener_(tf_buffer_, nh_),
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
    if (!gate_)
    {
      gate_.emplace(nh_, BeamGateOptions());
    }
    gate_->reset(configuration_fault_);
    ROS_FATAL_STREAM(pnh_.getNamespace() << " is idle: " << configuration_fault_);
  }
  timer_ = nh_.createSteadyTimer(ros::WallDuration(1.0), &MotionEstimationRos::timerCb, this);
}

MotionEstimationRos::~MotionEstimationRos()
{
  // A nodelet's callbacks may be running in another thread: this waits for them, before any member goes.
  timer_.stop();
  refinement_timer_.stop();
  refine_server_.shutdown();
  gate_.reset();
  for (View& view : views_)
  {
    view.camera_info_subscriber.shutdown();
    view.tracked_region_subscriber.shutdown();
  }
}

void MotionEstimationRos::start()
{
  parameters_ = readMotionEstimationParameters(pnh_);
  gate_.emplace(nh_, parameters_.gate);
  const PoseVerificationOptions& verification = parameters_.gate.verification;
  ROS_WARN_STREAM_COND(verification.registration && verification.initial_pose_verified,
                       "gate/initial_pose_verified counts for nothing while refinement/mode is not never: the "
                       "registration has to confirm the initial pose");
  setup_ = loadTreatmentSetup(parameters_.setup_file);
  reference_ = setup_.room_from_patient;
  shape_ = std::async(parameters_.bone_shape ? std::launch::async : std::launch::deferred,
                      [setup = setup_, bone = parameters_.bone_shape]
                      { return bone ? boneShape(setup) : TargetShape::isotropic(setup.targetCentre()); });
  consistency_.emplace(parameters_.consistency);
  rigid_consistency_.emplace(parameters_.rigid_consistency);
  predictor_.emplace(parameters_.prediction, setup_.targetCentre());
  motion_publisher_ = nh_.advertise<PatientMotion>("patient_motion", 100);
  pose_publisher_ = nh_.advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 100);
  prediction_publisher_ = nh_.advertise<geometry_msgs::PoseWithCovarianceStamped>("predicted_pose", 100);
  startRefinement();
  const std::vector<std::string>& detectors = parameters_.detectors;
  assembler_.emplace(detectors.size(), parameters_.queue_size, nanosecondsFromSeconds(parameters_.pairing_tolerance),
                     ros::Time::isSimTime() ? kClockTick : kMaxAhead);
  measurements_.resize(detectors.size());
  views_.resize(detectors.size());
  const ros::TransportHints no_delay = ros::TransportHints().tcpNoDelay();
  for (std::size_t i = 0; i < detectors.size(); ++i)
  {
    View& view = views_[i];
    view.name = detectors[i];
    const boost::function<void(const sensor_msgs::CameraInfo::ConstPtr&)> camera_info_cb =
        [this, &view](const sensor_msgs::CameraInfo::ConstPtr& info) { view.camera_info.update(view.name, *info); };
    view.camera_info_subscriber =
        nh_.subscribe<sensor_msgs::CameraInfo>(view.name + "/camera_info", 10, camera_info_cb, nullptr, no_delay);
    const boost::function<void(const TrackedRegion::ConstPtr&)> tracked_region_cb =
        [this, i](const TrackedRegion::ConstPtr& message) { trackedRegionCb(message, i); };
    view.tracked_region_subscriber = nh_.subscribe<TrackedRegion>(view.name + "/tracked_region", parameters_.queue_size,
                                                                  tracked_region_cb, nullptr, no_delay);
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
  first_heard_ = std::min(first_heard_.value_or(message->header.stamp), message->header.stamp);
  if (started_.isZero())
  {
    started_ = ros::Time::now();
  }
  using Outcome = ExposureAssembler<TrackedRegion::ConstPtr>::Outcome;
  const ros::Time now = ros::Time::now();
  const Outcome outcome =
      assembler_->add(view, nanosecondsFromTime(message->header.stamp), message, nanosecondsFromTime(now));
  if (outcome != Outcome::COMPLETE && outcome != Outcome::FUTURE)
  {
    return;
  }
  const ros::Time stamp = timeFromNanoseconds(assembler_->stamp());
  if (assembler_->restarted())
  {
    ROS_WARN_STREAM("exposures start again at " << stamp << ": forgetting the earlier ones");
    forget();
    first_heard_ = started_ = stamp;
  }

  ++exposures_;
  last_exposure_ = ros::SteadyTime::now();
  PatientMotion motion;
  motion.header.stamp = stamp;
  motion.header.frame_id = kRoomFrame;
  std::optional<MotionEstimate> result;
  if (outcome == Outcome::FUTURE)
  {
    motion.state = PatientMotion::BAD_STAMP;
    std::ostringstream reason;
    reason << "the exposure is stamped " << (stamp - now).toSec() << " s in the future: clocks differ";
    motion.reason = reason.str();
  }
  else
  {
    result = estimate(motion);
  }
  if (motion.state == PatientMotion::OK)
  {
    const std::int64_t nanoseconds = assembler_->stamp();
    for (std::size_t i = 0; i < views_.size(); ++i)
    {
      // A template's reference is known by its own view's stamp.
      if (i == 0 || assembler_->offset(i) != 0)
      {
        history_.add(nanoseconds + assembler_->offset(i), result->room_from_patient);
      }
    }
    last_pose_ = { nanoseconds, result->room_from_patient };
    publishPose(*result, stamp);
    ++poses_;
    predictor_->add(nanoseconds, result->room_from_patient, result->pose_covariance);
    publishPrediction();
  }
  tellGate(motion, result);
  double cpu_seconds = 0.0;
  double wall_seconds = 0.0;
  for (const TrackedRegion::ConstPtr& region : assembler_->exposure())
  {
    if (!region)
    {
      continue;
    }
    cpu_seconds += region->cpu_time.toSec();
    wall_seconds = std::max(wall_seconds, region->wall_time.toSec());
  }
  motion.cpu_time = durationFromSeconds(cpu_seconds + stopwatch.cpuSeconds());
  motion.wall_time = durationFromSeconds(wall_seconds + stopwatch.wallSeconds());
  motion_publisher_.publish(motion);
  if (outcome == Outcome::COMPLETE)
  {
    considerRefinement(motion, result);
  }
  report(motion);
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

void MotionEstimationRos::publishPose(const MotionEstimate& estimate, const ros::Time& stamp)
{
  geometry_msgs::TransformStamped transform;
  transform.header.stamp = stamp;
  transform.header.frame_id = kRoomFrame;
  transform.child_frame_id = kPatientFrame;
  transform.transform = transformMsgFromRigid(estimate.room_from_patient);
  tf_broadcaster_.sendTransform(transform);

  geometry_msgs::PoseWithCovarianceStamped pose;
  pose.header = transform.header;
  pose.pose = poseWithCovarianceMsg(estimate.room_from_patient, estimate.pose_covariance);
  pose_publisher_.publish(pose);
}

void MotionEstimationRos::publishPrediction()
{
  const std::int64_t now = nanosecondsFromTime(ros::Time::now());
  const std::optional<PosePrediction> prediction =
      predictor_->predict(now + nanosecondsFromSeconds(parameters_.prediction.latency));
  if (prediction)
  {
    geometry_msgs::PoseWithCovarianceStamped pose;
    pose.header.stamp = timeFromNanoseconds(prediction->stamp);
    pose.header.frame_id = kRoomFrame;
    pose.pose = poseWithCovarianceMsg(prediction->room_from_patient, prediction->covariance);
    prediction_publisher_.publish(pose);
  }
}

Eigen::Vector3d MotionEstimationRos::displacement(const RigidTransform& room_from_patient) const
{
  return room_from_patient * setup_.targetCentre() - setup_.room_from_patient * setup_.targetCentre();
}

void MotionEstimationRos::tellGate(const PatientMotion& motion, const std::optional<MotionEstimate>& estimate)
{
  GateExposure exposure;
  exposure.stamp = nanosecondsFromTime(motion.header.stamp);
  exposure.arrival = steadyNanoseconds();
  exposure.delay = nanosecondsFromTime(ros::Time::now()) - exposure.stamp;
  if (ros::Time::isSimTime())
  {
    exposure.delay = std::max<std::int64_t>(exposure.delay, 0);
  }
  exposure.text = motion.reason;
  if (motion.state == PatientMotion::INCONSISTENT)
  {
    exposure.fault = GateReason::INCONSISTENT;
  }
  else if (motion.state == PatientMotion::BAD_STAMP)
  {
    exposure.fault = GateReason::BAD_STAMP;
  }
  else if (motion.state == PatientMotion::OK)
  {
    exposure.fault = GateReason::NONE;
    exposure.displacement = displacement(estimate->room_from_patient);
    exposure.rotation = rotationAngle(estimate->room_from_patient * setup_.room_from_patient.inverse());
    exposure.covariance = estimate->covariance.topLeftCorner<3, 3>();
    for (std::size_t i = 0; i < views_.size(); ++i)
    {
      if (views_[i].doubt.state == PatientMotion::OK && assembler_->exposure()[i]->state == TrackedRegion::DEGRADED)
      {
        exposure.doubt = views_[i].name + " is degraded: much of its region does not look like the template";
      }
    }
  }
  gate_->update(exposure);
}

void MotionEstimationRos::forget()
{
  history_.clear();
  // This node's own transforms of the earlier run; static ones stay.
  tf_buffer_.clear();
  for (View& view : views_)
  {
    view.reference.reset();
  }
  reference_ = setup_.room_from_patient;
  reference_covariance_.setZero();
  tracked_views_.clear();
  estimator_.reset();
  consistency_->reset();
  rigid_consistency_->reset();
  last_pose_.reset();
  first_unseen_.reset();
  predictor_->reset();
  refinement_->reset();
  gate_->reset("exposures start again");
  // A bag that is played again begins with the patient where it began. A clock that was set, or old exposures that are
  // sent once more, find the patient anywhere, and the trackers learn their templates there.
  if (!ros::Time::isSimTime())
  {
    gate_->doubt("time went back: nothing has confirmed that the patient was at the initial pose again");
  }
}
}  // namespace xray_tracking
