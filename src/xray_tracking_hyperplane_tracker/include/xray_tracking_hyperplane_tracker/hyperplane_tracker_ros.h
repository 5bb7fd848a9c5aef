#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <xray_tracking_msgs/TrackedRegion.h>
#include <xray_tracking_msgs/TrainRegion.h>

#include "xray_tracking_hyperplane_tracker/bounded_queue.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_hyperplane_tracker/training_mailbox.h"

namespace xray_tracking
{
/// Tracks a region in one detector's exposures. Topics, service and parameters: README.md.
///
/// Exposures go through a bounded queue to a worker thread, which alone learns templates and tracks: callbacks never
/// wait for it, and every exposure is answered in order, those that arrived during a training after it. The service has
/// a callback queue and threads of its own.
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
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;
  using TrainRegion = xray_tracking_msgs::TrainRegion;

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
    double cpu_ms = 0.0;
    double wall_ms = 0.0;
    std::size_t exposures = 0;
    std::size_t stale = 0;  ///< exposures whose stamp was not newer
    std::optional<ros::SteadyTime> last_arrival;
  };

  void imageCb(const sensor_msgs::ImageConstPtr& image);
  bool trainRegionCb(TrainRegion::Request& request, TrainRegion::Response& response);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  // All below run in the worker thread.
  void work();
  void configure();
  void process(const Arrival& arrival);
  /// @return whether the exposure is to be answered; forgets the template when time jumps back
  bool acceptStamp(const ros::Time& stamp);
  /// Learns a template if there is reason to and tracks. @return what went wrong; empty: nothing
  std::string answer(const sensor_msgs::ImageConstPtr& image, TrackedRegion& result);
  /// Answers a request by training on the image.
  void serve(TrainingRequest& request, const cv::Mat& image, const ros::Time& stamp);
  /// @return what is wrong with the region or the image; empty: trained
  std::string train(const cv::Mat& image, const cv::Rect& region, const ros::Time& stamp);
  void track(const cv::Mat& image, TrackedRegion& result);
  void publishOverlay(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  ros::CallbackQueue service_queue_;
  TrackerParameters parameters_;
  std::string configuration_fault_;  ///< of parameters or setup file; empty: none

  std::unique_ptr<BoundedQueue<Arrival>> arrivals_;
  TrainingMailbox requests_;
  mutable std::mutex snapshot_mutex_;
  Snapshot snapshot_;

  std::optional<HyperplaneTracker> tracker_;
  std::optional<cv::Rect> region_;  ///< to train on while there is no template
  ros::Time reference_stamp_;
  ros::Time last_stamp_;
  std::string logged_fault_;
  std::uint8_t logged_state_ = TrackedRegion::UNTRAINED;

  ros::Publisher region_publisher_;
  ros::Publisher overlay_publisher_;
  ros::Subscriber image_subscriber_;
  ros::ServiceServer train_service_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
  std::unique_ptr<ros::AsyncSpinner> service_spinner_;
  std::thread worker_;
};
}  // namespace xray_tracking
