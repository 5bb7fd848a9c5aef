#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

#include <algorithm>
#include <set>
#include <sstream>
#include <stdexcept>

#include <time.h>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/parameters.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

/// Templates refer to exposures of the last seconds; the reference in use is kept apart.
constexpr std::size_t kHistoryCapacity = 1000;

const char* stateName(std::uint8_t state)
{
  static const char* const kNames[] = { "OK", "WAITING", "LOST", "INCONSISTENT", "NO_REFERENCE" };
  return kNames[state];
}

/// Time of this thread since construction: processor's and wall's.
class Stopwatch
{
public:
  ros::Duration processor() const { return ros::Duration(processorSeconds() - processor_start_); }
  ros::Duration wall() const { return ros::Duration((ros::SteadyTime::now() - wall_start_).toSec()); }

private:
  static double processorSeconds()
  {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }

  double processor_start_ = processorSeconds();
  ros::SteadyTime wall_start_ = ros::SteadyTime::now();
};

}  // namespace

MotionEstimationRos::MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh),
    pnh_(pnh),
    history_(kHistoryCapacity),
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
    ROS_FATAL_STREAM(pnh_.getNamespace() << " is idle: " << configuration_fault_);
  }
  timer_ = nh_.createSteadyTimer(ros::WallDuration(1.0), &MotionEstimationRos::timerCb, this);
}

void MotionEstimationRos::start()
{
  const std::string setup_file = readParameter<std::string>(pnh_, "setup_file", "");
  if (setup_file.empty())
  {
    throw std::invalid_argument("parameter " + pnh_.resolveName("setup_file") +
                                " is not set, expected the path of a setup file");
  }
  setup_ = loadTreatmentSetup(setup_file);

  options_.method = estimationMethodFromName(readParameter<std::string>(pnh_, "method", "least_squares"));
  options_.significance = readParameter(pnh_, "significance", options_.significance);
  options_.floor_sigma = readParameter(pnh_, "floor_sigma", options_.floor_sigma);
  options_.rotation_sigma = readParameter(pnh_, "rotation_sigma", options_.rotation_sigma);
  options_.min_view_angle = readParameter(pnh_, "min_view_angle", options_.min_view_angle);
  options_.validate();

  const int queue_size = readParameter(pnh_, "queue_size", 100);
  if (queue_size < 1)
  {
    throw std::invalid_argument("queue_size is " + std::to_string(queue_size) + ", expected 1 or more exposures");
  }
  view_timeout_ = readParameter(pnh_, "view_timeout", 2.0);
  if (!(view_timeout_ > 0.0))
  {
    throw std::invalid_argument("view_timeout is " + std::to_string(view_timeout_) + ", expected a number > 0 s");
  }
  const std::vector<std::string> fallback = { "detector_a", "detector_b" };
  const std::vector<std::string> detectors = readParameter(pnh_, "detectors", fallback);
  if (detectors.size() < 2 || std::set<std::string>(detectors.begin(), detectors.end()).size() != detectors.size())
  {
    throw std::invalid_argument("detectors has " + std::to_string(detectors.size()) +
                                " names, expected two or more that differ");
  }

  motion_publisher_ = nh_.advertise<PatientMotion>("patient_motion", 100);
  pose_publisher_ = nh_.advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 100);
  assembler_.emplace(detectors.size(), queue_size);
  measurements_.resize(detectors.size());
  views_.resize(detectors.size());
  const ros::TransportHints no_delay = ros::TransportHints().tcpNoDelay();
  for (std::size_t i = 0; i < detectors.size(); ++i)
  {
    View& view = views_[i];
    view.name = detectors[i];
    const boost::function<void(const sensor_msgs::CameraInfo::ConstPtr&)> camera_info_cb =
        [this, &view](const sensor_msgs::CameraInfo::ConstPtr& info) { cameraInfoCb(*info, view); };
    view.camera_info_subscriber =
        nh_.subscribe<sensor_msgs::CameraInfo>(view.name + "/camera_info", 10, camera_info_cb, nullptr, no_delay);
    const boost::function<void(const TrackedRegion::ConstPtr&)> tracked_region_cb =
        [this, i](const TrackedRegion::ConstPtr& message) { trackedRegionCb(message, i); };
    view.tracked_region_subscriber =
        nh_.subscribe<TrackedRegion>(view.name + "/tracked_region", queue_size, tracked_region_cb, nullptr, no_delay);
  }
}

void MotionEstimationRos::cameraInfoCb(const sensor_msgs::CameraInfo& info, View& view)
{
  if (view.camera_info.update(view.name, info) && !view.camera_info.fault().empty())
  {
    ROS_ERROR_STREAM(view.camera_info_subscriber.getTopic() << " ignored: " << view.camera_info.fault());
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
  const auto outcome = assembler_->add(view, nanosecondsFromTime(message->header.stamp), message);
  if (outcome != ExposureAssembler<TrackedRegion::ConstPtr>::Outcome::COMPLETE)
  {
    return;
  }
  if (assembler_->restarted())
  {
    ROS_WARN_STREAM("exposures start again at " << message->header.stamp << ": forgetting the earlier ones");
    forget();
  }

  ++exposures_;
  PatientMotion motion = motionFromStates();
  motion.header.stamp = message->header.stamp;
  motion.header.frame_id = kRoomFrame;
  if (motion.state == PatientMotion::OK)
  {
    const std::optional<MotionEstimate> result = estimate(motion);
    if (motion.state == PatientMotion::OK)
    {
      history_.add(nanosecondsFromTime(motion.header.stamp), result->room_from_patient);
      publishPose(*result, motion.header.stamp);
      ++poses_;
    }
  }
  for (const TrackedRegion::ConstPtr& region : assembler_->exposure())
  {
    motion.cpu_time += region->cpu_time;
    motion.wall_time = std::max(motion.wall_time, region->wall_time);
  }
  motion.cpu_time += stopwatch.processor();
  motion.wall_time += stopwatch.wall();
  motion_publisher_.publish(motion);
  report(motion);
}

PatientMotion MotionEstimationRos::motionFromStates() const
{
  PatientMotion motion;
  motion.views = static_cast<std::uint32_t>(views_.size());
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const std::uint8_t state = assembler_->exposure()[i]->state;
    const bool waiting = state == TrackedRegion::UNTRAINED || state == TrackedRegion::TRAINING;
    if (state == TrackedRegion::TRACKING || (waiting && motion.state == PatientMotion::LOST))
    {
      continue;
    }
    motion.state = waiting ? PatientMotion::WAITING : PatientMotion::LOST;
    motion.reason = views_[i].name;
    if (waiting)
    {
      motion.reason += state == TrackedRegion::TRAINING ? " is training" : " is untrained";
    }
    else
    {
      motion.reason +=
          state == TrackedRegion::LOST ? " has lost its region" : " has the unknown state " + std::to_string(state);
    }
  }
  return motion;
}

std::string MotionEstimationRos::makeEstimator()
{
  std::vector<ProjectionGeometry> geometries;
  try
  {
    for (const View& view : views_)
    {
      if (!view.camera_info.valid())
      {
        return "no valid " + view.camera_info_subscriber.getTopic() + " so far";
      }
      const auto room_from_optical = tf_buffer_.lookupTransform(kRoomFrame, view.camera_info.frame(), ros::Time(0));
      geometries.push_back(view.camera_info.geometry(view.name, rigidFromTransformMsg(room_from_optical.transform)));
    }
    estimator_.emplace(options_, std::move(geometries), setup_.targetCentre(), setup_.room_from_patient);
  }
  catch (const std::exception& error)  // tf2's, or of a geometry that is none
  {
    return error.what();
  }
  return std::string();
}

std::string MotionEstimationRos::findReferences()
{
  const auto& exposure = assembler_->exposure();
  if (history_.empty())
  {
    // The patient is taken to have kept its initial pose until all views track.
    for (std::size_t i = 0; i < views_.size(); ++i)
    {
      const ros::Time& stamp = exposure[i]->reference_stamp;
      history_.add(nanosecondsFromTime(stamp), setup_.room_from_patient);
      ROS_WARN_STREAM_COND(stamp != exposure[0]->reference_stamp,
                           views_[i].name << " was trained on the exposure at " << stamp << ", " << views_[0].name
                                          << " on that at " << exposure[0]->reference_stamp
                                          << ": motion between them stays unseen");
    }
  }
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    View& view = views_[i];
    const ros::Time& stamp = exposure[i]->reference_stamp;
    if (!view.reference || view.reference->first != stamp)
    {
      const std::optional<RigidTransform> pose = history_.at(nanosecondsFromTime(stamp));
      if (!pose)
      {
        std::ostringstream reason;
        reason << view.name << " was trained on the exposure at " << stamp << ", whose pose is not known";
        return reason.str();
      }
      view.reference = std::make_pair(stamp, *pose);
    }
  }
  return std::string();
}

std::optional<MotionEstimate> MotionEstimationRos::estimate(PatientMotion& motion)
{
  if (!estimator_ && !(motion.reason = makeEstimator()).empty())
  {
    motion.state = PatientMotion::WAITING;
    return std::nullopt;
  }
  if (!(motion.reason = findReferences()).empty())
  {
    motion.state = PatientMotion::NO_REFERENCE;
    return std::nullopt;
  }
  for (std::size_t i = 0; i < views_.size(); ++i)
  {
    const TrackedRegion& region = *assembler_->exposure()[i];
    measurements_[i].room_from_patient = views_[i].reference->second;
    measurements_[i].displacement = { region.displacement_x, region.displacement_y };
    measurements_[i].covariance =
        Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(region.covariance.data());
  }
  const MotionEstimate result = estimator_->estimate(measurements_);
  motion.reason = result.reason;
  if (result.status == EstimateStatus::INVALID)
  {
    motion.state = PatientMotion::LOST;
    return std::nullopt;
  }
  motion.state = result.status == EstimateStatus::OK ? PatientMotion::OK : PatientMotion::INCONSISTENT;
  motion.translation = vectorMsgFromMillimetres(result.translation);
  motion.covariance = covarianceMsgFromMillimetres(result.translation_covariance);
  motion.disagreement = result.disagreement;
  motion.chi_square = result.chi_square;
  motion.degrees_of_freedom = static_cast<std::uint32_t>(result.degrees_of_freedom);
  return result;
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

void MotionEstimationRos::report(const PatientMotion& motion)
{
  const bool changed = !last_motion_ || last_motion_->state != motion.state;
  last_motion_ = motion;
  if (changed && motion.state == PatientMotion::OK)
  {
    ROS_INFO_STREAM("patient's motion: OK from " << motion.header.stamp);
  }
  else if (changed)
  {
    ROS_WARN_STREAM("patient's motion: " << stateName(motion.state) << " from " << motion.header.stamp << ": "
                                         << motion.reason);
  }
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
}

void MotionEstimationRos::timerCb(const ros::SteadyTimerEvent&)
{
  const ros::SteadyTime now = ros::SteadyTime::now();
  const auto quiet = [&](const View& view)
  { return (now - std::max(view.last_arrival, first_arrival_)).toSec() > view_timeout_; };
  const bool any_arrives = !first_arrival_.isZero() && !std::all_of(views_.begin(), views_.end(), quiet);
  for (View& view : views_)
  {
    const bool silent = any_arrives && quiet(view);
    if (silent && !view.silent)
    {
      ROS_WARN_STREAM("nothing arrives on " << view.tracked_region_subscriber.getTopic()
                                            << " while other detectors send: no pose until it does");
    }
    view.silent = silent;
  }
  if (assembler_)
  {
    const std::size_t drops = assembler_->incomplete() + assembler_->duplicates() + assembler_->late();
    ROS_WARN_STREAM_COND(drops != drops_at_last_warning_,
                         "dropped so far: " << assembler_->incomplete() << " exposures that lack a view, "
                                            << assembler_->duplicates() << " duplicates, " << assembler_->late()
                                            << " late messages");
    drops_at_last_warning_ = drops;
  }
  updater_.force_update();
}

void MotionEstimationRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using diagnostic_msgs::DiagnosticStatus;
  if (!configuration_fault_.empty())
  {
    status.summary(DiagnosticStatus::ERROR, configuration_fault_);
    return;
  }
  if (!last_motion_)
  {
    status.summary(DiagnosticStatus::WARN, "no exposure so far");
  }
  else if (last_motion_->state == PatientMotion::OK)
  {
    status.summary(DiagnosticStatus::OK, "OK");
  }
  else
  {
    const bool waiting = last_motion_->state == PatientMotion::WAITING;
    status.summary(waiting ? DiagnosticStatus::WARN : DiagnosticStatus::ERROR,
                   std::string(stateName(last_motion_->state)) + ": " + last_motion_->reason);
  }
  for (const View& view : views_)
  {
    if (view.silent)
    {
      status.mergeSummary(DiagnosticStatus::WARN, view.name + " is silent");
    }
    if (!view.camera_info.fault().empty())
    {
      status.mergeSummary(DiagnosticStatus::ERROR, view.name + "/camera_info ignored: " + view.camera_info.fault());
    }
  }

  const ros::SteadyTime now = ros::SteadyTime::now();
  const double elapsed = (now - last_diagnosis_).toSec();
  status.add("rate [Hz]", static_cast<double>(exposures_ - exposures_at_last_diagnosis_) / elapsed);
  last_diagnosis_ = now;
  exposures_at_last_diagnosis_ = exposures_;
  status.add("exposures", exposures_);
  status.add("poses", poses_);
  status.add("exposures dropped, a view missing", assembler_->incomplete());
  status.add("duplicates dropped", assembler_->duplicates());
  status.add("late messages dropped", assembler_->late());
  if (last_motion_)
  {
    status.add("state", stateName(last_motion_->state));
    status.add("disagreement [px]", last_motion_->disagreement);
    status.add("chi-square", last_motion_->chi_square);
    status.add("processor time of the exposure [s]", last_motion_->cpu_time.toSec());
    status.add("wall time of the exposure [s]", last_motion_->wall_time.toSec());
  }
}
}  // namespace xray_tracking
