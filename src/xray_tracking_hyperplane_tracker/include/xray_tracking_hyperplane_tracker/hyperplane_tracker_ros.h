#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include <diagnostic_updater/diagnostic_updater.h>
#include <dynamic_reconfigure/server.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>
#include <std_srvs/Trigger.h>

#include <xray_tracking_msgs/TrackedRegion.h>
#include <xray_tracking_msgs/TrainRegion.h>

#include "xray_tracking_core/sequence/stamp_policy.h"
#include "xray_tracking_hyperplane_tracker/HyperplaneTrackerConfig.h"
#include "xray_tracking_hyperplane_tracker/bounded_queue.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_hyperplane_tracker/training_mailbox.h"
#include "xray_tracking_hyperplane_tracker/view_tracker.h"

namespace xray_tracking
{
/// Tracks a region in one detector's exposures. Topics, services and parameters: README.md.
///
/// Exposures go, shared and not copied, through a bounded queue to a worker thread, which alone learns templates and
/// tracks: callbacks never wait for it. Every exposure is answered in order, those that arrived during a training after
/// it. Only where the worker cannot keep up, that is, an exposure has waited for `max_wait` since, it goes on with the
/// newest and counts the others. The training services have a callback queue and threads of their own. What is learnt
/// while there is a template is learnt after the exposure's answer is out (ViewTracker).
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
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;
  using TrainRegion = xray_tracking_msgs::TrainRegion;
  using Trigger = std_srvs::Trigger;

  struct Arrival
  {
    sensor_msgs::ImageConstPtr image;
    ros::SteadyTime time;
  };
  /// What diagnostics tell.
  struct Snapshot
  {
    std::uint8_t state = TrackedRegion::UNTRAINED;
    std::string fault;  ///< of the configuration or the last exposure; empty: none
    double correlation = 0.0;
    double quality = 0.0;
    double cpu_ms = 0.0;
    double wall_ms = 0.0;
    double longest_wall_ms = 0.0;  ///< since the last report
    std::size_t exposures = 0;
    std::size_t bad_stamps = 0;  ///< exposures that were dropped for their stamp
    std::optional<ros::SteadyTime> last_arrival;
  };
  /// What the last report was, for what has happened since.
  struct Report
  {
    ros::SteadyTime time;
    std::size_t exposures = 0;
    std::size_t overdue = 0;
  };

  void imageCb(const sensor_msgs::ImageConstPtr& image);
  bool trainRegionCb(TrainRegion::Request& request, TrainRegion::Response& response);
  bool retrainCb(Trigger::Request& request, Trigger::Response& response);
  bool resetCb(Trigger::Request& request, Trigger::Response& response);
  /// Takes over what is safe to change; a contradiction is refused: `config` is then as it was.
  void reconfigureCb(Config& config);
  TrackerParameters settings() const;
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  /// Leaves a training for the next exposure and waits for its outcome.
  void serve(const Training& training, Trigger::Response& response);

  // All below run in the worker thread.
  void work();
  void configure();
  void makeTracker();
  void adoptSettings();
  void process(const Arrival& arrival);
  /// @return whether the exposure is to be answered; forgets the template when time jumps back
  bool acceptStamp(const ros::Time& stamp);
  void publish(const Arrival& arrival, const ViewAnswer& answer, double cpu_seconds);
  /// Once the exposure is answered. @param pixels empty: the image has none that can be read
  void finish(TrainingRequest& request, const sensor_msgs::ImageConstPtr& image, const cv::Mat& pixels,
              const ViewAnswer& answer);
  /// Takes note of a template that was learnt on this image.
  void noteReference(const sensor_msgs::ImageConstPtr& image);
  void showState(std::uint8_t state);
  void tell(const TrackedRegion& result, const std::string& error);
  void publishOverlay(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  ros::CallbackQueue service_queue_;
  mutable std::mutex settings_mutex_;
  TrackerParameters settings_;  ///< of which the thresholds, times and debug options may change
  std::atomic<bool> settings_changed_{ false };
  Config last_config_ = Config::__getDefault__();
  std::string configuration_fault_;  ///< of parameters or setup file; empty: none

  std::unique_ptr<BoundedQueue<Arrival>> arrivals_;
  TrainingMailbox requests_;
  const sensor_msgs::Image* last_received_ = nullptr;  ///< of the image callback
  ros::Time last_received_stamp_;
  mutable std::mutex snapshot_mutex_;
  Snapshot snapshot_;
  Report last_report_;

  // The worker's.
  TrackerParameters parameters_;
  IntensityModel intensity_;
  std::optional<ViewTracker> tracker_;       ///< none: the configuration is faulty
  HyperplaneTracker* hyperplane_ = nullptr;  ///< the tracker's, for its thresholds
  sensor_msgs::ImageConstPtr reference_;     ///< that the template was trained on
  ros::SteadyTime training_end_;
  StampPolicy stamps_;
  std::string logged_error_;
  std::uint8_t logged_state_ = TrackedRegion::UNTRAINED;

  ros::Publisher region_publisher_;
  ros::Publisher overlay_publisher_;
  ros::Subscriber image_subscriber_;
  ros::ServiceServer train_service_;
  ros::ServiceServer retrain_service_;
  ros::ServiceServer reset_service_;
  std::unique_ptr<dynamic_reconfigure::Server<Config>> reconfigure_server_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
  std::unique_ptr<ros::AsyncSpinner> service_spinner_;
  std::thread worker_;
};
}  // namespace xray_tracking
