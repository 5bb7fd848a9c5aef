#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

#include <exception>
#include <stdexcept>

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
  std::string fault;
  try
  {
    settings_ = readTrackerParameters(ParameterReader(pnh_), lastName(nh_.getNamespace()));
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  worker_ = std::make_unique<TrackerWorker>(nh_, pnh_.getNamespace(), settings_, fault, status_);
  updater_.setHardwareID(settings_.detector.empty() ? "none" : settings_.detector);
  updater_.add("region", this, &HyperplaneTrackerRos::diagnose);
  timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });
  if (fault.empty())
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
}

HyperplaneTrackerRos::~HyperplaneTrackerRos()
{
  worker_->stop();
  timer_.stop();
  reconfigure_server_.reset();
  service_spinner_->stop();
}

bool HyperplaneTrackerRos::trainRegionCb(TrainRegion::Request& request, TrainRegion::Response& response)
{
  try
  {
    response = worker_->train({ Training::Kind::REGION, rectFromRegionMsg(request.region) }, settings().train_timeout);
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
  const TrainRegion::Response outcome = worker_->train(training, settings().train_timeout);
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
  worker_->setSettings(wanted);
  const std::lock_guard<std::mutex> lock(settings_mutex_);
  settings_ = wanted;
}

TrackerParameters HyperplaneTrackerRos::settings() const
{
  const std::lock_guard<std::mutex> lock(settings_mutex_);
  return settings_;
}

void HyperplaneTrackerRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  status_.report(nh_.resolveName("image_raw"), settings().image_timeout, worker_->drops(), status);
}
}  // namespace xray_tracking
