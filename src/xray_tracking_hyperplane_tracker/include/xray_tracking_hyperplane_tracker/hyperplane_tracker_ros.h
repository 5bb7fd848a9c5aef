#pragma once

#include <memory>
#include <mutex>
#include <string>

#include <diagnostic_updater/diagnostic_updater.h>
#include <dynamic_reconfigure/server.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <xray_tracking_msgs/TrainRegion.h>

#include "xray_tracking_hyperplane_tracker/HyperplaneTrackerConfig.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_hyperplane_tracker/tracker_status.h"
#include "xray_tracking_hyperplane_tracker/tracker_worker.h"

namespace xray_tracking
{
/// Tracks a region in one detector's exposures. Topics, services and parameters: README.md.
///
/// A TrackerWorker answers the exposures; here is what controls it: parameters, the training services, which have a
/// callback queue and threads of their own, dynamic_reconfigure and diagnostics.
///
/// Parameters or a setup file that it cannot work with are reported in the log and in diagnostics; exposures are then
/// answered as untrained.
class HyperplaneTrackerRos
{
public:
  HyperplaneTrackerRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~HyperplaneTrackerRos();
  HyperplaneTrackerRos(const HyperplaneTrackerRos&) = delete;
  HyperplaneTrackerRos& operator=(const HyperplaneTrackerRos&) = delete;

private:
  using Config = xray_tracking_hyperplane_tracker::HyperplaneTrackerConfig;
  using TrainRegion = xray_tracking_msgs::TrainRegion;
  using Trigger = std_srvs::Trigger;

  bool trainRegionCb(TrainRegion::Request& request, TrainRegion::Response& response);
  bool retrainCb(Trigger::Request& request, Trigger::Response& response);
  bool resetCb(Trigger::Request& request, Trigger::Response& response);
  void serve(const Training& training, Trigger::Response& response);
  /// Takes over what is safe to change; a contradiction is refused: `config` is then as it was.
  void reconfigureCb(Config& config);
  TrackerParameters settings() const;
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  ros::CallbackQueue service_queue_;
  mutable std::mutex settings_mutex_;
  TrackerParameters settings_;  ///< of which the thresholds, times and debug options may change
  Config last_config_ = Config::__getDefault__();
  TrackerStatus status_;
  std::unique_ptr<TrackerWorker> worker_;

  ros::ServiceServer train_service_;
  ros::ServiceServer retrain_service_;
  ros::ServiceServer reset_service_;
  std::unique_ptr<dynamic_reconfigure::Server<Config>> reconfigure_server_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
  std::unique_ptr<ros::AsyncSpinner> service_spinner_;
};
}  // namespace xray_tracking
