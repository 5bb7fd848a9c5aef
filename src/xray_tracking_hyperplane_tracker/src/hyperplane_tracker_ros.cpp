#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

#include <cmath>
#include <exception>
#include <stdexcept>

#include "state_names.h"
#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
std::string lastName(const std::string& name_space)
{
  return name_space.substr(name_space.find_last_of('/') + 1);
}

void apply(const xray_tracking_hyperplane_tracker::HyperplaneTrackerConfig& config, TrackerParameters& parameters)
{
  parameters.tracker.min_correlation = config.min_correlation;
  parameters.tracker.found_correlation = config.found_correlation;
  parameters.tracker.min_quality = config.min_quality;
  parameters.tracker.good_quality = config.good_quality;
  parameters.max_wait = config.max_wait;
  parameters.train_timeout = config.train_timeout;
  parameters.image_timeout = config.image_timeout;
  parameters.overlay_points = config.overlay_points;
}
}  // namespace

HyperplaneTrackerRos::HyperplaneTrackerRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh), pnh_(pnh), updater_(nh_, pnh_, pnh_.getNamespace())
{
  try
  {
    settings_ = readTrackerParameters(pnh_, lastName(nh_.getNamespace()));
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
  }
  parameters_ = settings_;
  arrivals_ = std::make_unique<BoundedQueue<Arrival>>(static_cast<std::size_t>(parameters_.queue_size));

  region_publisher_ = nh_.advertise<TrackedRegion>("tracked_region", 100);
  overlay_publisher_ = nh_.advertise<sensor_msgs::Image>("tracked_region_image", 2);
  updater_.setHardwareID(parameters_.detector.empty() ? "none" : parameters_.detector);
  updater_.add("region", this, &HyperplaneTrackerRos::diagnose);
  last_report_.time = ros::SteadyTime::now();
  timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });
  if (configuration_fault_.empty())
  {
    // It writes its values to the parameter server, so not where these are what is to be corrected.
    reconfigure_server_ = std::make_unique<dynamic_reconfigure::Server<Config>>(pnh_);
    reconfigure_server_->setCallback([this](Config& config, std::uint32_t) { reconfigureCb(config); });
  }

  ros::NodeHandle services(nh_);
  services.setCallbackQueue(&service_queue_);
  train_service_ = services.advertiseService("train_region", &HyperplaneTrackerRos::trainRegionCb, this);
  retrain_service_ = services.advertiseService("retrain", &HyperplaneTrackerRos::retrainCb, this);
  reset_service_ = services.advertiseService("reset", &HyperplaneTrackerRos::resetCb, this);
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
  reconfigure_server_.reset();
  service_spinner_->stop();
}

void HyperplaneTrackerRos::imageCb(const sensor_msgs::ImageConstPtr& image)
{
  // roscpp links publisher and subscriber of one process twice if both come up at the same time.
  if (image.get() == last_received_ && image->header.stamp == last_received_stamp_)
  {
    return;
  }
  last_received_ = image.get();
  last_received_stamp_ = image->header.stamp;
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
    response = requests_.ask({ Training::Kind::REGION, rectFromRegionMsg(request.region) }, settings().train_timeout);
  }
  catch (const std::invalid_argument& error)
  {
    response = TrainingMailbox::makeResponse(TrainRegion::Response::INVALID_REGION, error.what());
  }
  return true;
}

bool HyperplaneTrackerRos::retrainCb(Trigger::Request&, Trigger::Response& response)
{
  serve({ Training::Kind::AGAIN, {} }, response);
  return true;
}

bool HyperplaneTrackerRos::resetCb(Trigger::Request&, Trigger::Response& response)
{
  serve({ Training::Kind::ANEW, {} }, response);
  return true;
}

void HyperplaneTrackerRos::serve(const Training& training, Trigger::Response& response)
{
  const TrainRegion::Response outcome = requests_.ask(training, settings().train_timeout);
  response.success = static_cast<std::uint8_t>(outcome.status == TrainRegion::Response::OK);
  response.message = outcome.message;
}

void HyperplaneTrackerRos::reconfigureCb(Config& config)
{
  TrackerParameters wanted = settings();
  apply(config, wanted);
  try
  {
    wanted.validate();
  }
  catch (const std::invalid_argument& error)
  {
    ROS_ERROR_STREAM(pnh_.getNamespace() << " refuses new settings: " << error.what());
    config = last_config_;
    return;
  }
  last_config_ = config;
  const std::lock_guard<std::mutex> lock(settings_mutex_);
  settings_ = wanted;
  settings_changed_ = true;
}

TrackerParameters HyperplaneTrackerRos::settings() const
{
  const std::lock_guard<std::mutex> lock(settings_mutex_);
  return settings_;
}

void HyperplaneTrackerRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  Snapshot now;
  {
    const std::lock_guard<std::mutex> lock(snapshot_mutex_);
    now = snapshot_;
    snapshot_.longest_wall_ms = 0.0;
  }
  const BoundedQueue<Arrival>::Drops drops = arrivals_->drops();
  const Report report{ ros::SteadyTime::now(), now.exposures, drops.overdue };
  const double elapsed = (report.time - last_report_.time).toSec();
  const std::size_t newly_overdue = report.overdue - last_report_.overdue;
  using diagnostic_msgs::DiagnosticStatus;
  const double silence = now.last_arrival ? (report.time - *now.last_arrival).toSec() : 0.0;
  if (!now.fault.empty())
  {
    status.summary(DiagnosticStatus::ERROR, now.fault);
  }
  else if (!now.last_arrival)
  {
    status.summary(DiagnosticStatus::WARN, "no exposure on " + nh_.resolveName("image_raw") + " yet");
  }
  else if (silence > settings().image_timeout)
  {
    status.summaryf(DiagnosticStatus::WARN, "no exposure on %s for %.1f s", nh_.resolveName("image_raw").c_str(),
                    silence);
  }
  else if (newly_overdue > 0)
  {
    status.summary(DiagnosticStatus::WARN,
                   "too slow: " + std::to_string(newly_overdue) + " exposures dropped since the last report");
  }
  else
  {
    status.summary(now.state == TrackedRegion::TRACKING ? DiagnosticStatus::OK : DiagnosticStatus::WARN,
                   stateName(now.state));
  }
  status.add("state", stateName(now.state));
  status.add("correlation", now.correlation);
  status.add("residual, of the template's contrast", std::sqrt(std::max(0.0, 1.0 - now.correlation * now.correlation)));
  status.add("quality", now.quality);
  status.add("exposures a second", elapsed > 0.0 ? (now.exposures - last_report_.exposures) / elapsed : 0.0);
  status.add("exposures answered", now.exposures);
  status.add("exposures dropped, queue full", drops.full);
  status.add("exposures dropped, too slow", drops.overdue);
  status.add("exposures dropped, stamp not newer or in the future", now.bad_stamps);
  status.add("processor time of the last exposure [ms]", now.cpu_ms);
  status.add("image to result, last exposure [ms]", now.wall_ms);
  status.add("image to result, longest since the last report [ms]", now.longest_wall_ms);
  last_report_ = report;
}
}  // namespace xray_tracking
