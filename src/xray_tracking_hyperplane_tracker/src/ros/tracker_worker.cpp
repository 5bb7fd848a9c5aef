#include "xray_tracking_hyperplane_tracker/tracker_worker.h"

#include <algorithm>
#include <exception>
#include <stdexcept>

#include <cv_bridge/cv_bridge.h>
#include <ros/serialization.h>
#include <sensor_msgs/image_encodings.h>
#include <xray_tracking_msgs/RegionResiduals.h>
#include <boost/make_shared.hpp>

#include "../state_names.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/stopwatch.h"
#include "xray_tracking_hyperplane_tracker/region_overlay.h"
#include "xray_tracking_hyperplane_tracker/residual_points.h"

namespace xray_tracking
{
namespace
{
namespace encodings = sensor_msgs::image_encodings;
using xray_tracking_msgs::TrackedRegion;
using xray_tracking_msgs::TrainRegion;

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

xray_tracking_msgs::RegionResiduals residualsMessage(const std_msgs::Header& header,
                                                     const std::vector<ResidualPoint>& points)
{
  xray_tracking_msgs::RegionResiduals message;
  message.header = header;
  for (const ResidualPoint& point : points)
  {
    message.u.push_back(point.place.x);
    message.v.push_back(point.place.y);
    message.residual.push_back(point.residual);
  }
  return message;
}

/// What a training that worked is said to have done.
std::string successOf(const Training& training, bool trained, const ros::Time& stamp)
{
  const std::string exposure = "the exposure of " + std::to_string(stamp.toSec());
  return training.kind == Training::Kind::AGAIN ? "learnt again from " + exposure
         : trained                              ? "trained on " + exposure
                   : "the template is forgotten as of " + exposure + "; there is no region to learn another one of";
}
}  // namespace

TrackerWorker::TrackerWorker(const ros::NodeHandle& nh, const std::string& name, const TrackerParameters& parameters,
                             const std::string& fault, TrackerStatus& status)
  : nh_(nh),
    name_(name),
    status_(status),
    arrivals_(static_cast<std::size_t>(parameters.queue_size)),
    settings_(parameters),
    parameters_(parameters),
    configuration_fault_(fault),
    region_publisher_(nh_.advertise<TrackedRegion>("tracked_region", 100)),
    overlay_publisher_(nh_.advertise<sensor_msgs::Image>("tracked_region_image", 2)),
    residuals_publisher_(nh_.advertise<xray_tracking_msgs::RegionResiduals>("region_residuals", 2)),
    thread_([this] { work(); })
{
}

void TrackerWorker::stop()
{
  arrivals_.close();
  if (thread_.joinable())
  {
    thread_.join();
  }
  image_subscriber_.shutdown();
}

void TrackerWorker::setSettings(const TrackerParameters& settings)
{
  const std::lock_guard<std::mutex> lock(settings_mutex_);
  settings_ = settings;
  settings_changed_ = true;
}

void TrackerWorker::imageCb(const sensor_msgs::ImageConstPtr& image)
{
  // roscpp links publisher and subscriber of one process twice if both come up at the same time.
  if (image.get() == last_received_ && image->header.stamp == last_received_stamp_)
  {
    return;
  }
  last_received_ = image.get();
  last_received_stamp_ = image->header.stamp;
  const ros::SteadyTime now = ros::SteadyTime::now();
  status_.noteArrival(now);
  arrivals_.push({ image, now });
}

void TrackerWorker::work()
{
  configure();
  image_subscriber_ = nh_.subscribe("image_raw", static_cast<std::uint32_t>(parameters_.queue_size),
                                    &TrackerWorker::imageCb, this, ros::TransportHints().tcpNoDelay());
  const auto overdue = [this](const Arrival& arrival)
  {
    return arrival.time > training_end_ &&
           ros::SteadyTime::now() - arrival.time > ros::WallDuration(parameters_.max_wait);
  };
  while (const std::optional<Arrival> arrival = arrivals_.pop(overdue))
  {
    process(*arrival);
  }
  requests_.close();
  // Of a nodelet that is unloaded, as its loader has died, another one takes the place.
  if (restart_file_ && !ros::ok())
  {
    restart_file_->remove();
  }
}

void TrackerWorker::configure()
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
        ROS_WARN_STREAM(name_ << ": " << parameters_.setup_file << " has no detector '" << parameters_.detector
                              << "', so its pixels are taken to be " << parameters_.resolution
                              << " mm at the target (resolution)");
      }
      else
      {
        parameters_.adopt(setup);
      }
    }
    makeTracker();
    takeUp();
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
    ROS_ERROR_STREAM(name_ << " tracks nothing: " << configuration_fault_);
    status_.setFault(configuration_fault_);
  }
}

void TrackerWorker::makeTracker()
{
  auto hyperplane = std::make_unique<HyperplaneTracker>(parameters_.tracker, intensity_);
  hyperplane_ = hyperplane.get();
  tracker_.emplace(std::move(hyperplane), intensity_, parameters_.tracker.reduction, parameters_.tracker.model,
                   parameters_.model_by_data, parameters_.region, parameters_.image_size);
}

void TrackerWorker::takeUp()
{
  if (!parameters_.keep_for_restart)
  {
    return;
  }
  restart_file_.emplace(ros::NodeHandle(name_), "template 1");
  if (!restart_file_->succeeds())
  {
    return;
  }
  try
  {
    std::string bytes = restart_file_->read();
    ros::serialization::IStream stream(reinterpret_cast<std::uint8_t*>(bytes.data()),
                                       static_cast<std::uint32_t>(bytes.size()));
    sensor_msgs::RegionOfInterest wanted;
    const auto image = boost::make_shared<sensor_msgs::Image>();
    ros::serialization::deserialize(stream, wanted);
    ros::serialization::deserialize(stream, kept_usual_);
    ros::serialization::deserialize(stream, *image);
    const std::int64_t stamp = nanosecondsFromTime(image->header.stamp);
    tracker_->takeUp(pixelsFromMsg(*image), stamp, rectFromRegionMsg(wanted),
                     kept_usual_ > 0.0 ? std::make_optional(kept_usual_) : std::nullopt);
    // What is older than it is of another run.
    stamps_.take(stamp, 0);
    reference_ = kept_ = image;
    ROS_WARN_STREAM(
        name_ << " has died and was started again: it looks for the region that was learnt on the exposure of "
              << image->header.stamp);
  }
  catch (const std::exception& error)
  {
    ROS_ERROR_STREAM(name_ << " has died and was started again; it cannot take up the template that it had, and learns "
                              "another one: "
                           << error.what());
  }
}

void TrackerWorker::keep()
{
  if (!restart_file_ || (!reference_ && !kept_))
  {
    return;
  }
  constexpr double kNotable = 1.5;
  constexpr double kSeldom = 5.0;  // [s]
  const double usual = tracker_->usualUnexplained().value_or(0.0);
  const bool is_seen_otherwise = usual > kNotable * kept_usual_ || kept_usual_ > kNotable * usual;
  const ros::SteadyTime now = ros::SteadyTime::now();
  if (reference_ == kept_ && (!is_seen_otherwise || (now - kept_at_).toSec() < kSeldom))
  {
    return;
  }
  kept_ = reference_;
  kept_usual_ = usual;
  kept_at_ = now;
  if (!reference_)
  {
    restart_file_->remove();
    return;
  }
  try
  {
    const sensor_msgs::RegionOfInterest wanted =
        regionMsgFromRect(tracker_->wantedRegion().value_or(tracker_->region()));
    const std::uint32_t length = ros::serialization::serializationLength(wanted) +
                                 ros::serialization::serializationLength(usual) +
                                 ros::serialization::serializationLength(*reference_);
    std::string bytes(length, '\0');
    ros::serialization::OStream stream(reinterpret_cast<std::uint8_t*>(bytes.data()), length);
    ros::serialization::serialize(stream, wanted);
    ros::serialization::serialize(stream, usual);
    ros::serialization::serialize(stream, *reference_);
    restart_file_->write(bytes);
  }
  catch (const std::exception& error)
  {
    ROS_WARN_STREAM_THROTTLE(60.0, name_ << " does not keep its template for a restart: " << error.what()
                                         << "; make room, or mend the folder");
  }
}

void TrackerWorker::adoptSettings()
{
  if (settings_changed_.exchange(false))
  {
    {
      const std::lock_guard<std::mutex> lock(settings_mutex_);
      parameters_ = settings_;
    }
    if (hyperplane_ != nullptr)
    {
      hyperplane_->setThresholds(parameters_.tracker);
    }
  }
}

bool TrackerWorker::acceptStamp(const ros::Time& stamp)
{
  using Verdict = StampPolicy::Verdict;
  const Verdict verdict = stamps_.take(nanosecondsFromTime(stamp), nanosecondsFromTime(ros::Time::now()));
  if (verdict == Verdict::FUTURE || verdict == Verdict::REPEATED_OR_LATE)
  {
    if (throttle_.due("dropped"))
    {
      ROS_WARN_STREAM(
          name_ << " drops an exposure: " << stamps_.why()
                << "; check the detector's and this computer's clocks, and that nobody else publishes there");
    }
    status_.noteBadStamp();
    return false;
  }
  if (verdict == Verdict::RESTART)
  {
    if (throttle_.due("restart"))
    {
      ROS_WARN_STREAM(name_ << " starts anew: " << stamps_.why()
                            << "; unless a bag is played again, check the detector's and this computer's clocks");
    }
    if (tracker_)
    {
      tracker_->startAnew();
      reference_.reset();
    }
  }
  return true;
}

void TrackerWorker::process(const Arrival& arrival)
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
  cv::Mat pixels;
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
      status_.setState(TrackedRegion::TRAINING);
    }
    try
    {
      pixels = pixelsFromMsg(*image);
      answer = tracker_->answer(pixels, nanosecondsFromTime(image->header.stamp),
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
    finish(*request, image, pixels, answer);
  }
  keep();
}

void TrackerWorker::publish(const Arrival& arrival, const ViewAnswer& answer, double cpu_seconds)
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
  publishResiduals(arrival.image, *result);
}

void TrackerWorker::finish(TrainingRequest& request, const sensor_msgs::ImageConstPtr& image, const cv::Mat& pixels,
                           const ViewAnswer& answer)
{
  std::string fault = answer.fault;
  if (tracker_)
  {
    status_.setState(TrackedRegion::TRAINING);
    fault = pixels.empty() ? answer.fault : tracker_->learn(pixels);
    noteReference(image);
    status_.setState(static_cast<std::uint8_t>(answer.state));
  }
  request.response.set_value(
      fault.empty() ? TrainingMailbox::makeResponse(
                          TrainRegion::Response::OK,
                          successOf(request.training, tracker_ && tracker_->trained(), image->header.stamp))
                    : TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, fault));
}

void TrackerWorker::noteReference(const sensor_msgs::ImageConstPtr& image)
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
    ROS_WARN_STREAM(name_ << " tracks " << inside.width << " x " << inside.height << " at (" << inside.x << ", "
                          << inside.y
                          << "), the part of its region inside the X-ray field; if that shows too little of "
                          << "the target, open the blades or draw another region");
  }
}

void TrackerWorker::tell(const TrackedRegion& result, const std::string& error)
{
  if (error.empty())
  {
    logged_error_.clear();
  }
  else if (error != logged_error_ && throttle_.due("error"))
  {
    ROS_ERROR_STREAM(name_ << ", exposure of " << result.header.stamp << ": " << error);
    logged_error_ = error;
  }
  if (result.state != logged_state_ && throttle_.due(stateName(result.state)))
  {
    ROS_INFO_STREAM(name_ << " is " << stateName(result.state) << " (correlation " << result.correlation << ", quality "
                          << result.quality << ")" << (result.fault.empty() ? "" : ": ") << result.fault);
    logged_state_ = result.state;
  }
  status_.noteAnswer(result, error);
}

void TrackerWorker::publishResiduals(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result)
{
  const bool picture = overlay_publisher_.getNumSubscribers() > 0;
  const bool points = residuals_publisher_.getNumSubscribers() > 0;
  if (!picture && !points)
  {
    return;
  }
  try
  {
    const cv::Mat pixels = pixelsFromMsg(*image);
    RegionOverlay overlay;
    overlay.reference = rectFromRegionMsg(result.region);
    overlay.colour = stateColour(result.state);
    std::vector<ResidualPoint> residuals;
    if (isFound(result.state))
    {
      overlay.found = tracker_->lastTrack();
      if (points || parameters_.overlay_points)
      {
        residuals = residualPoints(pixelsFromMsg(*reference_), overlay.reference, pixels, *overlay.found, intensity_);
      }
    }
    if (points)
    {
      residuals_publisher_.publish(residualsMessage(image->header, residuals));
    }
    if (picture)
    {
      if (parameters_.overlay_points)
      {
        overlay.points = std::move(residuals);
      }
      const cv::Mat drawn = drawRegionOverlay(pixels, overlay);
      overlay_publisher_.publish(cv_bridge::CvImage(image->header, encodings::BGR8, drawn).toImageMsg());
    }
  }
  catch (const std::exception&)
  {
    // The exposure's fault has been reported with its answer.
  }
}
}  // namespace xray_tracking
