#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

#include <algorithm>
#include <set>
#include <sstream>
#include <stdexcept>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_core/option_check.h"
#include "xray_tracking_core/stopwatch.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

/// Templates refer to exposures of the last seconds; the reference in use is kept apart.
constexpr std::size_t kHistoryCapacity = 1000;

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

MotionEstimationRos::~MotionEstimationRos()
{
  // A nodelet's callbacks may be running in another thread: this waits for them, before any member goes.
  timer_.stop();
  for (View& view : views_)
  {
    view.camera_info_subscriber.shutdown();
    view.tracked_region_subscriber.shutdown();
  }
}

void MotionEstimationRos::start()
{
  ParameterReader reader(pnh_);
  const std::string setup_file = reader.read<std::string>("setup_file", "");
  options_.method = estimationMethodFromName(reader.read<std::string>("method", "least_squares"));
  options_.significance = reader.read("significance", options_.significance);
  options_.floor_sigma = reader.read("floor_sigma", options_.floor_sigma);
  options_.rotation_sigma = reader.read("rotation_sigma", options_.rotation_sigma);
  options_.min_view_angle = reader.read("min_view_angle", options_.min_view_angle);
  options_.validate();
  const int queue_size = reader.read("queue_size", 100);
  requireOption(queue_size >= 1, "queue_size", queue_size, "1 or more exposures");
  view_timeout_ = reader.read("view_timeout", 2.0);
  requireOption(view_timeout_ > 0.0, "view_timeout", view_timeout_, "a number > 0 s");
  const std::vector<std::string> fallback = { "detector_a", "detector_b" };
  const std::vector<std::string> detectors = reader.read("detectors", fallback);
  requireOption(
      detectors.size() >= 2 && std::set<std::string>(detectors.begin(), detectors.end()).size() == detectors.size(),
      "the length of detectors", detectors.size(), "two or more names that differ");
  reader.warnOfUnread();
  if (setup_file.empty())
  {
    throw std::invalid_argument("parameter " + pnh_.resolveName("setup_file") +
                                " is not set, expected the path of a setup file");
  }
  setup_ = loadTreatmentSetup(setup_file);

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
        [this, &view](const sensor_msgs::CameraInfo::ConstPtr& info) { view.camera_info.update(view.name, *info); };
    view.camera_info_subscriber =
        nh_.subscribe<sensor_msgs::CameraInfo>(view.name + "/camera_info", 10, camera_info_cb, nullptr, no_delay);
    const boost::function<void(const TrackedRegion::ConstPtr&)> tracked_region_cb =
        [this, i](const TrackedRegion::ConstPtr& message) { trackedRegionCb(message, i); };
    view.tracked_region_subscriber =
        nh_.subscribe<TrackedRegion>(view.name + "/tracked_region", queue_size, tracked_region_cb, nullptr, no_delay);
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
  last_exposure_ = ros::SteadyTime::now();
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
  double cpu_seconds = 0.0;
  double wall_seconds = 0.0;
  for (const TrackedRegion::ConstPtr& region : assembler_->exposure())
  {
    cpu_seconds += region->cpu_time.toSec();
    wall_seconds = std::max(wall_seconds, region->wall_time.toSec());
  }
  motion.cpu_time = durationFromSeconds(cpu_seconds + stopwatch.cpuSeconds());
  motion.wall_time = durationFromSeconds(wall_seconds + stopwatch.wallSeconds());
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
    if (state == TrackedRegion::TRACKING || state == TrackedRegion::DEGRADED || (waiting && motion.state == PatientMotion::LOST))
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

std::string MotionEstimationRos::checkGeometry()
{
  try
  {
    for (View& view : views_)
    {
      const CameraInfoWatch& camera_info = view.camera_info;
      if (!camera_info.fault().empty())
      {
        return view.name + ": " + camera_info.fault();
      }
      if (!camera_info.valid())
      {
        return "no " + nh_.resolveName(view.name + "/camera_info") + " so far";
      }
      const auto message = tf_buffer_.lookupTransform(kRoomFrame, camera_info.frame(), ros::Time(0));
      const RigidTransform room_from_optical = rigidFromTransformMsg(message.transform);
      if (!estimator_)
      {
        view.room_from_optical = room_from_optical;
      }
      // Rounding of what combines transforms is let through; in mm and of the rotation times the distances, it is less
      // than a micrometre.
      else if (!room_from_optical.isApprox(view.room_from_optical, 1e-10))
      {
        return view.name + ": frame " + camera_info.frame() + " has moved in " + kRoomFrame +
               ", expected it to stay where it was at first";
      }
    }
    if (!estimator_)
    {
      std::vector<ProjectionGeometry> geometries;
      for (const View& view : views_)
      {
        geometries.push_back(view.camera_info.geometry(view.name, view.room_from_optical));
      }
      estimator_.emplace(options_, std::move(geometries), setup_.targetCentre(), setup_.room_from_patient);
    }
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
  if (!(motion.reason = checkGeometry()).empty())
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
        Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(region.covariance.data()).topLeftCorner<2, 2>();
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
}  // namespace xray_tracking
