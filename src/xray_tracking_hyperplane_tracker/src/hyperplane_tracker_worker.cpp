// What HyperplaneTrackerRos does in its worker thread: from an exposure to its answer.
#include <algorithm>
#include <cmath>
#include <exception>
#include <stdexcept>

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>
#include <boost/make_shared.hpp>

#include "state_names.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/stopwatch.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"
#include "xray_tracking_hyperplane_tracker/region_overlay.h"

namespace xray_tracking
{
namespace
{
namespace encodings = sensor_msgs::image_encodings;
using xray_tracking_msgs::TrackedRegion;

/// Time that stamps go back by when a bag starts again; less is a disorder of exposures.
const ros::Duration kBackwardJump(1.0);
/// How far in the future a stamp may be: beyond, the next good one would look like a bag that starts again.
const ros::Duration kAhead = kBackwardJump;
/// Share of the region outside the field from which on it is not looked for: what covers more than a quarter disturbs.
constexpr double kMostOutside = 0.5;
const TrackedRegion::_linear_type kIdentity = { 1.0, 0.0, 0.0, 1.0 };

cv::Scalar stateColour(std::uint8_t state)
{
  return state == TrackedRegion::TRACKING   ? cv::Scalar(80, 200, 80)
         : state == TrackedRegion::DEGRADED ? cv::Scalar(40, 180, 230)
                                            : cv::Scalar(60, 60, 230);
}

bool isFound(std::uint8_t state)
{
  return state == TrackedRegion::TRACKING || state == TrackedRegion::DEGRADED;
}

bool hasDetector(const TreatmentSetup& setup, const std::string& name)
{
  return std::any_of(setup.detectors.begin(), setup.detectors.end(),
                     [&name](const ProjectionGeometry& detector) { return detector.name() == name; });
}

/// Why a region was not found.
const char* lossName(TrackResult::Status status)
{
  switch (status)
  {
    case TrackResult::Status::OUT_OF_IMAGE:
      return "the region has left the image";
    case TrackResult::Status::DIVERGED:
      return "the search for the region did not settle";
    default:
      return "nothing looks enough like the region";
  }
}

double finiteOrZero(double value)
{
  return std::isfinite(value) ? value : 0.0;
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
}  // namespace

void HyperplaneTrackerRos::work()
{
  configure();
  image_subscriber_ = nh_.subscribe("image_raw", static_cast<std::uint32_t>(parameters_.queue_size),
                                    &HyperplaneTrackerRos::imageCb, this, ros::TransportHints().tcpNoDelay());
  const auto overdue = [this](const Arrival& arrival)
  {
    return arrival.time > training_end_ &&
           ros::SteadyTime::now() - arrival.time > ros::WallDuration(parameters_.max_wait);
  };
  while (const std::optional<Arrival> arrival = arrivals_->pop(overdue))
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
    configured_region_ = parameters_.region;
    if (!parameters_.setup_file.empty())
    {
      const TreatmentSetup setup = loadTreatmentSetup(parameters_.setup_file);
      intensity_ = setup.intensity;
      if (configured_region_ && !hasDetector(setup, parameters_.detector))
      {
        ROS_WARN_STREAM(pnh_.getNamespace() << ": " << parameters_.setup_file << " has no detector '"
                                            << parameters_.detector << "', so its pixels are taken to be "
                                            << parameters_.resolution << " mm at the target (resolution)");
      }
      else
      {
        adoptGeometry(setup);
      }
    }
    region_ = configured_region_;
    makeTracker();
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
    ROS_ERROR_STREAM(pnh_.getNamespace() << " tracks nothing: " << configuration_fault_);
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.fault = configuration_fault_;
  }
}

void HyperplaneTrackerRos::adoptGeometry(const TreatmentSetup& setup)
{
  const ProjectionGeometry& geometry = setup.detector(parameters_.detector);
  const double magnification = geometry.magnification(setup.room_from_patient * setup.targetCentre());
  if (!(magnification > 0.0))
  {
    throw std::invalid_argument("the target is not in front of the source of " + geometry.name());
  }
  parameters_.scaleTo(geometry.pixelPitch().mean() / magnification);
  const auto given = setup.regions.find(parameters_.detector);
  if (!configured_region_)
  {
    configured_region_ = given != setup.regions.end() ? given->second : projectedTargetRegion(setup, geometry);
  }
}

void HyperplaneTrackerRos::makeTracker()
{
  std::unique_ptr<RegionTracker> tracker;
  if (parameters_.method == TrackingMethod::HYPERPLANE)
  {
    auto hyperplane = std::make_unique<HyperplaneTracker>(parameters_.tracker, intensity_);
    hyperplane_ = hyperplane.get();
    tracker = std::move(hyperplane);
  }
  else
  {
    auto registration = std::make_unique<TemplateRegistration>(parameters_.registration, intensity_);
    registration_ = registration.get();
    tracker = std::move(registration);
  }
  tracker_.emplace(std::move(tracker), intensity_, parameters_.tracker.reduction);
  check_.emplace(intensity_);
}

void HyperplaneTrackerRos::adoptSettings()
{
  if (settings_changed_.exchange(false))
  {
    parameters_ = settings();
    if (hyperplane_ != nullptr)
    {
      hyperplane_->setThresholds(parameters_.tracker);
    }
    if (registration_ != nullptr)
    {
      registration_->setThresholds(parameters_.registration);
    }
  }
}

void HyperplaneTrackerRos::startAnew()
{
  if (tracker_)
  {
    tracker_->reset();
    check_->reset();
  }
  reference_.reset();
}

bool HyperplaneTrackerRos::acceptStamp(const ros::Time& stamp)
{
  const ros::Time now = ros::Time::now();  // zero: simulated, and no clock has come yet
  const bool ahead = !now.isZero() && stamp > now + kAhead;
  const bool older = !last_stamp_.isZero() && stamp <= last_stamp_;
  if (ahead || (older && last_stamp_ - stamp <= kBackwardJump))
  {
    ROS_WARN_STREAM_THROTTLE(1.0, pnh_.getNamespace() << " drops the exposure of " << stamp << ", expected a stamp "
                                                      << (ahead ? "before " : "after ") << (ahead ? now : last_stamp_));
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    ++snapshot_.bad_stamps;
    return false;
  }
  if (older)
  {
    ROS_WARN_STREAM(pnh_.getNamespace() << " starts anew: time went back from " << last_stamp_ << " to " << stamp);
    startAnew();
  }
  last_stamp_ = stamp;
  return true;
}

void HyperplaneTrackerRos::process(const Arrival& arrival)
{
  const Stopwatch stopwatch;
  adoptSettings();
  if (!acceptStamp(arrival.image->header.stamp))
  {
    return;
  }
  if (reset_asked_.exchange(false))
  {
    ROS_INFO_STREAM(pnh_.getNamespace() << " starts anew: it was asked to");
    startAnew();
    region_ = configured_region_;
  }
  const auto result = boost::make_shared<TrackedRegion>();
  result->header = arrival.image->header;
  result->model = static_cast<std::uint8_t>(parameters_.tracker.model);
  result->linear = kIdentity;
  const std::string fault = answer(arrival.image, *result);
  result->cpu_time = ros::Duration(stopwatch.cpuSeconds());
  result->wall_time = ros::Duration((ros::SteadyTime::now() - arrival.time).toSec());
  region_publisher_.publish(result);
  tell(*result, fault);
  publishOverlay(arrival.image, *result);
}

void HyperplaneTrackerRos::tell(const TrackedRegion& result, const std::string& fault)
{
  if (fault != logged_fault_ && !fault.empty())
  {
    ROS_ERROR_STREAM(pnh_.getNamespace() << ", exposure of " << result.header.stamp << ": " << fault);
  }
  logged_fault_ = fault;
  if (result.state != logged_state_)
  {
    ROS_INFO_STREAM(pnh_.getNamespace() << " is " << stateName(result.state) << " (correlation " << result.correlation
                                        << ", quality " << result.quality << ")" << (result.fault.empty() ? "" : ": ")
                                        << result.fault);
    logged_state_ = result.state;
  }
  const std::lock_guard<std::mutex> lock(snapshot_mutex_);
  snapshot_.state = result.state;
  snapshot_.fault = fault;
  snapshot_.correlation = result.correlation;
  snapshot_.quality = result.quality;
  snapshot_.cpu_ms = 1e3 * result.cpu_time.toSec();
  snapshot_.wall_ms = 1e3 * result.wall_time.toSec();
  snapshot_.longest_wall_ms = std::max(snapshot_.longest_wall_ms, snapshot_.wall_ms);
  ++snapshot_.exposures;
}

std::string HyperplaneTrackerRos::answer(const sensor_msgs::ImageConstPtr& image, TrackedRegion& result)
{
  const std::shared_ptr<TrainingRequest> request = requests_.take();
  std::string fault = configuration_fault_;
  std::optional<TrainRegion::Response> outcome;
  try
  {
    if (tracker_)
    {
      const cv_bridge::CvImageConstPtr pixels = pixelsOf(image);
      result.fault = check_->look(pixels->image, static_cast<std::int64_t>(image->header.stamp.toNSec()));
      if (!result.fault.empty())
      {
        // Neither a template nor a loss: the next one that shows something goes on from the last one that did.
        result.state = TrackedRegion::BLIND;
      }
      else
      {
        fault = answerUsable(pixels->image, image, request.get(), result, outcome);
      }
    }
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  if (!fault.empty())
  {
    result.fault = fault;
  }
  if (request)
  {
    request->response.set_value(
        outcome ? *outcome : TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, result.fault));
  }
  if (tracker_ && tracker_->trained())
  {
    result.region = regionMsgFromRect(tracker_->region());
    result.reference_stamp = reference_->header.stamp;
    if (!isFound(result.state) && result.state != TrackedRegion::BLIND)
    {
      result.state = TrackedRegion::LOST;
    }
  }
  return fault;
}

std::string HyperplaneTrackerRos::answerUsable(const cv::Mat& pixels, const sensor_msgs::ImageConstPtr& image,
                                               const TrainingRequest* request, TrackedRegion& result,
                                               std::optional<TrainRegion::Response>& outcome)
{
  std::string fault;
  if (request && request->region)
  {
    outcome = serveTraining(*request->region, pixels, image);
  }
  if (!tracker_->trained() && region_)
  {
    fault = train(pixels, *region_, image);
  }
  if (tracker_->trained())
  {
    track(pixels, result);
    if (image == reference_)
    {
      // There it is by definition; what the tracker says is the image's noise.
      result.displacement_x = result.displacement_y = 0.0;
      result.linear = kIdentity;
    }
  }
  if (request && !request->region)
  {
    outcome = serveRetraining(check_->repaired(pixels), result);
  }
  return fault;
}

HyperplaneTrackerRos::TrainRegion::Response HyperplaneTrackerRos::serveTraining(const cv::Rect& region,
                                                                                const cv::Mat& pixels,
                                                                                const sensor_msgs::ImageConstPtr& image)
{
  const std::string fault = train(pixels, region, image);
  if (!fault.empty())
  {
    return TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, fault);
  }
  region_ = region;
  return TrainingMailbox::makeResponse(TrainRegion::Response::OK,
                                       "trained on the exposure of " + std::to_string(image->header.stamp.toSec()));
}

HyperplaneTrackerRos::TrainRegion::Response HyperplaneTrackerRos::serveRetraining(const cv::Mat& pixels,
                                                                                  const TrackedRegion& result)
{
  const auto refuse = [](const std::string& why)
  { return TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, why); };
  if (hyperplane_ == nullptr)
  {
    return refuse("the method does not learn from more than the first exposure");
  }
  if (result.state != TrackedRegion::TRACKING)
  {
    return refuse(std::string("the region is ") + stateName(result.state) + " in the exposure of " +
                  std::to_string(result.header.stamp.toSec()) + ", expected tracking");
  }
  if (!hyperplane_->retrain(pixels))
  {
    return refuse("the region was not found");
  }
  training_end_ = ros::SteadyTime::now();
  return TrainingMailbox::makeResponse(
      TrainRegion::Response::OK, "learnt again from the exposure of " + std::to_string(result.header.stamp.toSec()));
}

std::string HyperplaneTrackerRos::train(const cv::Mat& pixels, const cv::Rect& region,
                                        const sensor_msgs::ImageConstPtr& image)
{
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    snapshot_.state = TrackedRegion::TRAINING;
  }
  std::string fault;
  try
  {
    const cv::Rect inside = check_->learn(pixels, region);
    if (inside != region)
    {
      ROS_WARN_STREAM(pnh_.getNamespace() << " tracks " << inside.width << " x " << inside.height << " at (" << inside.x
                                          << ", " << inside.y << "), the part of its region inside the X-ray field");
    }
    tracker_->train(check_->repaired(pixels), inside);
    reference_ = image;
  }
  catch (const std::invalid_argument& error)
  {
    fault = error.what();
  }
  training_end_ = ros::SteadyTime::now();
  return fault;
}

void HyperplaneTrackerRos::track(const cv::Mat& pixels, TrackedRegion& result)
{
  const double outside = check_->outside(tracker_->lastPlace());
  const bool covered = outside > kMostOutside;
  if (covered)
  {
    result.state = TrackedRegion::BLIND;
    result.fault = "of the region " + std::to_string(std::lround(100.0 * outside)) +
                   " % are outside the field (collimator blades, the image's rim)";
    // What was lost before may be elsewhere.
    if (!tracker_->lost())
    {
      return;
    }
  }
  const cv::Mat& repaired = check_->repaired(pixels);
  if (const std::string& mixed = check_->mixed(repaired, tracker_->lastPlace()); !mixed.empty())
  {
    result.state = TrackedRegion::BLIND;
    result.fault = mixed;
    return;
  }
  TrackResult track = tracker_->track(repaired);
  if (!track.found() && isFound(logged_state_) && check_->learnStuck(pixels))
  {
    track = tracker_->track(check_->repaired(pixels));
  }
  if (parameters_.model_by_data && !tellsRotation(track))
  {
    track = withoutLinearPart(track);
    result.model = TrackedRegion::TRANSLATION;
  }
  result.correlation = finiteOrZero(track.correlation);
  result.quality = finiteOrZero(track.quality);
  result.iterations = static_cast<std::uint32_t>(track.iterations);
  // Nor is it found where there is nothing to be seen.
  const bool in_field = !covered || check_->outside(tracker_->lastPlace()) <= kMostOutside;
  if (in_field && track.found() && track.displacement.allFinite() && track.linear.allFinite() &&
      track.covariance.allFinite())
  {
    result.state = track.status == TrackResult::Status::TRACKED ? TrackedRegion::TRACKING : TrackedRegion::DEGRADED;
    result.displacement_x = track.displacement.x();
    result.displacement_y = track.displacement.y();
    Eigen::Map<Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(result.linear.data()) = track.linear;
    Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(result.covariance.data()) =
        0.5 * (track.covariance + track.covariance.transpose());  // rounding is not symmetric
    result.fault.clear();
  }
  else if (!covered)
  {
    result.state = TrackedRegion::LOST;
    result.fault = lossName(track.status);
  }
}

void HyperplaneTrackerRos::publishOverlay(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result)
{
  if (overlay_publisher_.getNumSubscribers() == 0)
  {
    return;
  }
  try
  {
    const cv_bridge::CvImageConstPtr pixels = pixelsOf(image);
    RegionOverlay overlay;
    overlay.reference = rectFromRegionMsg(result.region);
    overlay.colour = stateColour(result.state);
    if (isFound(result.state))
    {
      overlay.found = tracker_->result();
      if (parameters_.overlay_points)
      {
        overlay.points =
            residualPoints(pixelsOf(reference_)->image, overlay.reference, pixels->image, *overlay.found, intensity_);
      }
    }
    const cv::Mat picture = drawRegionOverlay(pixels->image, overlay);
    overlay_publisher_.publish(cv_bridge::CvImage(image->header, encodings::BGR8, picture).toImageMsg());
  }
  catch (const std::exception&)
  {
    // The exposure's fault has been reported with its answer.
  }
}
}  // namespace xray_tracking
