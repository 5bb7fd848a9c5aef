// What HyperplaneTrackerRos does in its worker thread: from an exposure to its answer.
#include <algorithm>
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

static_assert(static_cast<int>(ViewAnswer::State::UNTRAINED) == TrackedRegion::UNTRAINED &&
                  static_cast<int>(ViewAnswer::State::TRACKING) == TrackedRegion::TRACKING &&
                  static_cast<int>(ViewAnswer::State::LOST) == TrackedRegion::LOST &&
                  static_cast<int>(ViewAnswer::State::DEGRADED) == TrackedRegion::DEGRADED &&
                  static_cast<int>(ViewAnswer::State::BLIND) == TrackedRegion::BLIND,
              "ViewAnswer::State has TrackedRegion's numbers");

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

void setMotion(const ViewAnswer& answer, TrackedRegion& message)
{
  const TrackResult& motion = answer.motion;
  message.displacement_x = motion.displacement.x();
  message.displacement_y = motion.displacement.y();
  Eigen::Map<Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(message.linear.data()) = motion.linear;
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(message.covariance.data()) = motion.covariance;
  message.correlation = motion.correlation;
  message.quality = motion.quality;
  message.iterations = static_cast<std::uint32_t>(motion.iterations);
}

/// What a training that worked is said to have done.
std::string successOf(const Training& training, bool trained, const ros::Time& stamp)
{
  const std::string exposure = "the exposure of " + std::to_string(stamp.toSec());
  return training.kind == Training::Kind::AGAIN ? "learnt again from " + exposure
         : trained                              ? "trained on " + exposure
                   : "the template is forgotten as of " + exposure + "; there is no region to learn another one of";
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
    if (!parameters_.setup_file.empty())
    {
      const TreatmentSetup setup = loadTreatmentSetup(parameters_.setup_file);
      intensity_ = setup.intensity;
      if (parameters_.region && !hasDetector(setup, parameters_.detector))
      {
        ROS_WARN_STREAM(pnh_.getNamespace() << ": " << parameters_.setup_file << " has no detector '"
                                            << parameters_.detector << "', so its pixels are taken to be "
                                            << parameters_.resolution << " mm at the target (resolution)");
      }
      else
      {
        parameters_.adopt(setup);
      }
    }
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

void HyperplaneTrackerRos::makeTracker()
{
  auto hyperplane = std::make_unique<HyperplaneTracker>(parameters_.tracker, intensity_);
  hyperplane_ = hyperplane.get();
  tracker_.emplace(std::move(hyperplane), intensity_, parameters_.tracker.reduction, parameters_.tracker.model,
                   parameters_.model_by_data, parameters_.region);
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
  }
}

bool HyperplaneTrackerRos::acceptStamp(const ros::Time& stamp)
{
  using Verdict = StampPolicy::Verdict;
  const Verdict verdict = stamps_.take(nanosecondsFromTime(stamp), nanosecondsFromTime(ros::Time::now()));
  if (verdict == Verdict::FUTURE || verdict == Verdict::REPEATED_OR_LATE)
  {
    ROS_WARN_STREAM_THROTTLE(1.0, pnh_.getNamespace() << " drops an exposure: " << stamps_.why());
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    ++snapshot_.bad_stamps;
    return false;
  }
  if (verdict == Verdict::RESTART)
  {
    ROS_WARN_STREAM(pnh_.getNamespace() << " starts anew: " << stamps_.why());
    if (tracker_)
    {
      tracker_->startAnew();
      reference_.reset();
    }
  }
  return true;
}

void HyperplaneTrackerRos::process(const Arrival& arrival)
{
  const Stopwatch stopwatch;
  adoptSettings();
  const sensor_msgs::ImageConstPtr& image = arrival.image;
  if (!acceptStamp(image->header.stamp))
  {
    return;
  }
  const std::shared_ptr<TrainingRequest> request = requests_.take();
  ViewAnswer answer;
  cv_bridge::CvImageConstPtr pixels;
  if (!tracker_)
  {
    answer.model = parameters_.tracker.model;
    answer.fault = configuration_fault_;
    answer.error = true;
  }
  else
  {
    const bool is_first = !tracker_->trained();
    if (is_first && (request || tracker_->wantedRegion()))
    {
      showState(TrackedRegion::TRAINING);
    }
    try
    {
      pixels = pixelsOf(image);
      answer = tracker_->answer(pixels->image, nanosecondsFromTime(image->header.stamp),
                                request ? std::optional<Training>(request->training) : std::nullopt);
    }
    catch (const std::exception& error)
    {
      answer = tracker_->answerUnreadable(error.what());
    }
    if (is_first)
    {
      noteReference(image);
    }
  }
  publish(arrival, answer, stopwatch.cpuSeconds());
  if (request)
  {
    finish(*request, image, pixels ? pixels->image : cv::Mat(), answer);
  }
}

void HyperplaneTrackerRos::publish(const Arrival& arrival, const ViewAnswer& answer, double cpu_seconds)
{
  const auto result = boost::make_shared<TrackedRegion>();
  result->header = arrival.image->header;
  result->state = static_cast<std::uint8_t>(answer.state);
  result->fault = answer.fault;
  result->model = static_cast<std::uint8_t>(answer.model);
  result->region = regionMsgFromRect(answer.region);
  result->reference_stamp = timeFromNanoseconds(answer.reference_stamp_ns);
  setMotion(answer, *result);
  result->cpu_time = ros::Duration(cpu_seconds);
  result->wall_time = ros::Duration((ros::SteadyTime::now() - arrival.time).toSec());
  region_publisher_.publish(result);
  tell(*result, answer.error ? answer.fault : std::string());
  publishOverlay(arrival.image, *result);
}

void HyperplaneTrackerRos::finish(TrainingRequest& request, const sensor_msgs::ImageConstPtr& image,
                                  const cv::Mat& pixels, const ViewAnswer& answer)
{
  std::string fault = answer.fault;
  if (tracker_)
  {
    showState(TrackedRegion::TRAINING);
    fault = pixels.empty() ? answer.fault : tracker_->learn(pixels);
    noteReference(image);
    showState(static_cast<std::uint8_t>(answer.state));
  }
  request.response.set_value(
      fault.empty() ? TrainingMailbox::makeResponse(
                          TrainRegion::Response::OK,
                          successOf(request.training, tracker_ && tracker_->trained(), image->header.stamp))
                    : TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, fault));
}

void HyperplaneTrackerRos::noteReference(const sensor_msgs::ImageConstPtr& image)
{
  training_end_ = ros::SteadyTime::now();
  if (!tracker_->trained())
  {
    reference_.reset();
    return;
  }
  if (reference_ && nanosecondsFromTime(reference_->header.stamp) == tracker_->referenceStamp())
  {
    return;
  }
  reference_ = image;
  const cv::Rect inside = tracker_->region();
  if (inside != tracker_->wantedRegion())
  {
    ROS_WARN_STREAM(pnh_.getNamespace() << " tracks " << inside.width << " x " << inside.height << " at (" << inside.x
                                        << ", " << inside.y << "), the part of its region inside the X-ray field");
  }
}

void HyperplaneTrackerRos::showState(std::uint8_t state)
{
  const std::lock_guard<std::mutex> lock(snapshot_mutex_);
  snapshot_.state = state;
}

void HyperplaneTrackerRos::tell(const TrackedRegion& result, const std::string& error)
{
  if (error != logged_error_ && !error.empty())
  {
    ROS_ERROR_STREAM(pnh_.getNamespace() << ", exposure of " << result.header.stamp << ": " << error);
  }
  logged_error_ = error;
  if (result.state != logged_state_)
  {
    ROS_INFO_STREAM(pnh_.getNamespace() << " is " << stateName(result.state) << " (correlation " << result.correlation
                                        << ", quality " << result.quality << ")" << (result.fault.empty() ? "" : ": ")
                                        << result.fault);
    logged_state_ = result.state;
  }
  const std::lock_guard<std::mutex> lock(snapshot_mutex_);
  snapshot_.state = result.state;
  snapshot_.fault = error;
  snapshot_.correlation = result.correlation;
  snapshot_.quality = result.quality;
  snapshot_.cpu_ms = 1e3 * result.cpu_time.toSec();
  snapshot_.wall_ms = 1e3 * result.wall_time.toSec();
  snapshot_.longest_wall_ms = std::max(snapshot_.longest_wall_ms, snapshot_.wall_ms);
  ++snapshot_.exposures;
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
      overlay.found = tracker_->lastTrack();
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
