#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

#include <chrono>
#include <exception>
#include <stdexcept>
#include <utility>

#include <time.h>

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_overlay.h"

namespace xray_tracking
{
namespace
{
namespace encodings = sensor_msgs::image_encodings;

/// Time that stamps go back by when a bag starts again; less is a disorder of exposures.
const ros::Duration kBackwardJump(1.0);

const char* stateName(std::uint8_t state)
{
  static const char* const kNames[] = { "untrained", "training", "tracking", "lost" };
  return kNames[state];
}

cv::Scalar stateColour(std::uint8_t state)
{
  return state == xray_tracking_msgs::TrackedRegion::TRACKING ? cv::Scalar(80, 200, 80) : cv::Scalar(60, 60, 230);
}

double threadCpuSeconds()
{
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// The message's pixels, not copied. @throws std::invalid_argument or cv_bridge::Exception saying what is wrong
cv_bridge::CvImageConstPtr pixelsOf(const sensor_msgs::ImageConstPtr& image)
{
  const std::string& encoding = image->encoding;
  if (encoding != encodings::MONO16 && encoding != encodings::MONO8 && encoding != encodings::TYPE_16UC1 &&
      encoding != encodings::TYPE_8UC1)
  {
    throw std::invalid_argument("image: encoding is " + encoding + ", expected mono16 or mono8");
  }
  return cv_bridge::toCvShare(image);
}

std::string lastName(const std::string& name_space)
{
  return name_space.substr(name_space.find_last_of('/') + 1);
}
}  // namespace

HyperplaneTrackerRos::HyperplaneTrackerRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh), pnh_(pnh), updater_(nh_, pnh_, pnh_.getNamespace())
{
  try
  {
    parameters_ = readTrackerParameters(pnh_, lastName(nh_.getNamespace()));
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
  }
  arrivals_ = std::make_unique<BoundedQueue<Arrival>>(static_cast<std::size_t>(parameters_.queue_size));

  region_publisher_ = nh_.advertise<TrackedRegion>("tracked_region", 100);
  overlay_publisher_ = nh_.advertise<sensor_msgs::Image>("tracked_region_image", 2);
  updater_.setHardwareID(parameters_.detector.empty() ? "none" : parameters_.detector);
  updater_.add("region", this, &HyperplaneTrackerRos::diagnose);
  timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });

  auto service = ros::AdvertiseServiceOptions::create<TrainRegion>(
      "train_region",
      [this](TrainRegion::Request& request, TrainRegion::Response& response)
      { return trainRegionCb(request, response); },
      ros::VoidConstPtr(), &service_queue_);
  train_service_ = nh_.advertiseService(service);
  // Two threads: a second request is told at once that one is being served.
  service_spinner_ = std::make_unique<ros::AsyncSpinner>(2, &service_queue_);
  service_spinner_->start();
  worker_ = std::thread(&HyperplaneTrackerRos::work, this);
}

HyperplaneTrackerRos::~HyperplaneTrackerRos()
{
  arrivals_->close();
  worker_.join();
  image_subscriber_.shutdown();
  timer_.stop();
  service_spinner_->stop();
}

void HyperplaneTrackerRos::imageCb(const sensor_msgs::ImageConstPtr& image)
{
  const ros::SteadyTime now = ros::SteadyTime::now();
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.last_arrival = now;
  }
  arrivals_->push({ image, now });
}

bool HyperplaneTrackerRos::trainRegionCb(TrainRegion::Request& request, TrainRegion::Response& response)
{
  try
  {
    response = requests_.ask(rectFromRegionMsg(request.region), parameters_.train_timeout);
  }
  catch (const std::invalid_argument& error)
  {
    response = TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, error.what());
  }
  return true;
}

void HyperplaneTrackerRos::work()
{
  configure();
  image_subscriber_ = nh_.subscribe("image_raw", static_cast<std::uint32_t>(parameters_.queue_size),
                                    &HyperplaneTrackerRos::imageCb, this, ros::TransportHints().tcpNoDelay());
  while (const std::optional<Arrival> arrival = arrivals_->pop())
  {
    process(*arrival);
  }
  requests_.close();
}

void HyperplaneTrackerRos::configure()
{
  try
  {
    if (!configuration_fault_.empty())
    {
      throw std::invalid_argument(configuration_fault_);
    }
    IntensityModel intensity;
    region_ = parameters_.region;
    if (!parameters_.setup_file.empty())
    {
      const TreatmentSetup setup = loadTreatmentSetup(parameters_.setup_file);
      intensity = setup.intensity;
      const auto given = setup.regions.find(parameters_.detector);
      if (!region_)
      {
        region_ = given != setup.regions.end() ? given->second
                                               : projectedTargetRegion(setup, setup.detector(parameters_.detector));
      }
    }
    tracker_.emplace(parameters_.tracker, intensity);
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
    ROS_ERROR_STREAM(pnh_.getNamespace() << " tracks nothing: " << configuration_fault_);
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.fault = configuration_fault_;
  }
}

bool HyperplaneTrackerRos::acceptStamp(const ros::Time& stamp)
{
  if (!last_stamp_.isZero() && stamp <= last_stamp_)
  {
    if (last_stamp_ - stamp <= kBackwardJump)
    {
      ROS_WARN_STREAM_THROTTLE(
          1.0, pnh_.getNamespace() << " drops the exposure of " << stamp << ", expected a stamp after " << last_stamp_);
      const std::lock_guard<std::mutex> lock(snapshot_mutex_);
      ++snapshot_.stale;
      return false;
    }
    ROS_WARN_STREAM(pnh_.getNamespace() << " starts anew: time went back from " << last_stamp_ << " to " << stamp);
    if (tracker_)
    {
      tracker_->reset();
    }
  }
  last_stamp_ = stamp;
  return true;
}

void HyperplaneTrackerRos::process(const Arrival& arrival)
{
  const double cpu_start = threadCpuSeconds();
  if (!acceptStamp(arrival.image->header.stamp))
  {
    return;
  }
  TrackedRegion result;
  result.header = arrival.image->header;
  result.model = TrackedRegion::TRANSLATION;
  result.linear = { 1.0, 0.0, 0.0, 1.0 };
  const std::string fault = answer(arrival.image, result);
  result.cpu_time = ros::Duration(threadCpuSeconds() - cpu_start);
  result.wall_time = ros::Duration((ros::SteadyTime::now() - arrival.time).toSec());
  region_publisher_.publish(result);

  if (fault != logged_fault_ && !fault.empty())
  {
    ROS_ERROR_STREAM(pnh_.getNamespace() << ", exposure of " << result.header.stamp << ": " << fault);
  }
  logged_fault_ = fault;
  if (result.state != logged_state_)
  {
    ROS_INFO_STREAM(pnh_.getNamespace() << " is " << stateName(result.state) << " (correlation " << result.correlation
                                        << ")");
    logged_state_ = result.state;
  }
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.state = result.state;
    snapshot_.fault = fault;
    snapshot_.correlation = result.correlation;
    snapshot_.cpu_ms = 1e3 * result.cpu_time.toSec();
    snapshot_.wall_ms = 1e3 * result.wall_time.toSec();
    ++snapshot_.exposures;
  }
  publishOverlay(arrival.image, result);
}

std::string HyperplaneTrackerRos::answer(const sensor_msgs::ImageConstPtr& image, TrackedRegion& result)
{
  const std::shared_ptr<TrainingRequest> request = requests_.take();
  std::string fault = configuration_fault_;
  bool served = false;
  try
  {
    if (tracker_)
    {
      const cv_bridge::CvImageConstPtr pixels = pixelsOf(image);
      if (request)
      {
        served = true;
        serve(*request, pixels->image, image->header.stamp);
      }
      if (!tracker_->trained() && region_)
      {
        fault = train(pixels->image, *region_, image->header.stamp);
      }
      if (tracker_->trained())
      {
        track(pixels->image, result);
      }
    }
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  if (request && !served)
  {
    request->response.set_value(TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, fault));
  }
  if (tracker_ && tracker_->trained())
  {
    result.region = regionMsgFromRect(tracker_->region());
    result.reference_stamp = reference_stamp_;
    if (result.state != TrackedRegion::TRACKING)
    {
      result.state = TrackedRegion::LOST;
    }
  }
  return fault;
}

void HyperplaneTrackerRos::serve(TrainingRequest& request, const cv::Mat& image, const ros::Time& stamp)
{
  const std::string fault = train(image, request.region, stamp);
  if (fault.empty())
  {
    region_ = request.region;
    request.response.set_value(TrainingMailbox::makeResponse(
        TrainRegion::Response::OK, "trained on the exposure of " + std::to_string(stamp.toSec())));
  }
  else
  {
    request.response.set_value(TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, fault));
  }
}

void HyperplaneTrackerRos::track(const cv::Mat& image, TrackedRegion& result)
{
  const TrackResult& track = tracker_->track(image);
  result.correlation = track.correlation;
  result.iterations = static_cast<std::uint32_t>(track.iterations);
  if (track.status == TrackResult::Status::TRACKED)
  {
    result.state = TrackedRegion::TRACKING;
    result.displacement_x = track.displacement.x();
    result.displacement_y = track.displacement.y();
    Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(result.covariance.data()).topLeftCorner<2, 2>() =
        track.covariance;
    result.quality = std::max(0.0, track.correlation);
  }
}

std::string HyperplaneTrackerRos::train(const cv::Mat& image, const cv::Rect& region, const ros::Time& stamp)
{
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.state = TrackedRegion::TRAINING;
  }
  try
  {
    tracker_->train(image, region);
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  reference_stamp_ = stamp;
  return "";
}

void HyperplaneTrackerRos::publishOverlay(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result)
{
  if (overlay_publisher_.getNumSubscribers() == 0)
  {
    return;
  }
  try
  {
    RegionOverlay overlay;
    overlay.reference = rectFromRegionMsg(result.region);
    if (result.state == TrackedRegion::TRACKING)
    {
      overlay.displacement = Eigen::Vector2d(result.displacement_x, result.displacement_y);
    }
    overlay.colour = stateColour(result.state);
    const cv::Mat picture = drawRegionOverlay(pixelsOf(image)->image, overlay);
    overlay_publisher_.publish(cv_bridge::CvImage(image->header, encodings::BGR8, picture).toImageMsg());
  }
  catch (const std::exception&)
  {
    // The exposure's fault has been reported with its answer.
  }
}

void HyperplaneTrackerRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  Snapshot now;
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    now = snapshot_;
  }
  using diagnostic_msgs::DiagnosticStatus;
  const double silence = now.last_arrival ? (ros::SteadyTime::now() - *now.last_arrival).toSec() : 0.0;
  if (!now.fault.empty())
  {
    status.summary(DiagnosticStatus::ERROR, now.fault);
  }
  else if (!now.last_arrival)
  {
    status.summary(DiagnosticStatus::WARN, "no exposure on " + nh_.resolveName("image_raw") + " yet");
  }
  else if (silence > parameters_.image_timeout)
  {
    status.summaryf(DiagnosticStatus::WARN, "no exposure on %s for %.1f s", nh_.resolveName("image_raw").c_str(),
                    silence);
  }
  else
  {
    status.summary(now.state == TrackedRegion::TRACKING ? DiagnosticStatus::OK : DiagnosticStatus::WARN,
                   stateName(now.state));
  }
  status.add("state", stateName(now.state));
  status.add("correlation", now.correlation);
  status.add("exposures answered", now.exposures);
  status.add("exposures dropped, queue full", arrivals_->dropped());
  status.add("exposures dropped, stamp not newer", now.stale);
  status.add("processor time of the last exposure [ms]", now.cpu_ms);
  status.add("image to result, last exposure [ms]", now.wall_ms);
}
}  // namespace xray_tracking
