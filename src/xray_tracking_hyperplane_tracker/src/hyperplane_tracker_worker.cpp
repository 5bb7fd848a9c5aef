// HyperplaneTrackerRos's worker thread: what it is made of, and which exposures it takes.
#include <algorithm>
#include <exception>
#include <stdexcept>

#include <boost/make_shared.hpp>

#include "state_names.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/stopwatch.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::TrackedRegion;

/// Time that stamps go back by when a bag starts again; less is a disorder of exposures.
const ros::Duration kBackwardJump(1.0);
/// How far in the future a stamp may be: beyond, the next good one would look like a bag that starts again.
const ros::Duration kAhead = kBackwardJump;

bool hasDetector(const TreatmentSetup& setup, const std::string& name)
{
  return std::any_of(setup.detectors.begin(), setup.detectors.end(),
                     [&name](const ProjectionGeometry& detector) { return detector.name() == name; });
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
  result->linear = { { 1.0, 0.0, 0.0, 1.0 } };
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

}  // namespace xray_tracking
