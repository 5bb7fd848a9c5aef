#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_conversions/log_throttle.h"
#include "xray_tracking_conversions/restart_file.h"
#include "xray_tracking_core/sequence/stamp_policy.h"
#include "xray_tracking_hyperplane_tracker/bounded_queue.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_hyperplane_tracker/tracker_status.h"
#include "xray_tracking_hyperplane_tracker/training_mailbox.h"
#include "xray_tracking_hyperplane_tracker/view_tracker.h"

namespace xray_tracking
{
/// From image_raw to tracked_region, in a thread of its own that alone learns templates and tracks.
///
/// Exposures come, shared and not copied, through a bounded queue: callbacks never wait. Every exposure is answered in
/// order, those that arrived during a training after it. Only where the thread cannot keep up, that is, an exposure has
/// waited for `max_wait` since, it goes on with the newest and counts the others. What is learnt while there is a
/// template is learnt after the exposure's answer is out (ViewTracker).
class TrackerWorker
{
public:
  /// Advertises and starts; loads the setup file and subscribes in its thread.
  /// @param name of the node, for the log
  /// @param fault of the parameters; empty: none. Exposures are then answered as untrained, with it as the reason
  /// @param status outlives the worker
  TrackerWorker(const ros::NodeHandle& nh, const std::string& name, const TrackerParameters& parameters,
                const std::string& fault, TrackerStatus& status);
  ~TrackerWorker() { stop(); }
  TrackerWorker(const TrackerWorker&) = delete;
  TrackerWorker& operator=(const TrackerWorker&) = delete;

  /// Ends the thread; who waits for a training is told.
  void stop();

  /// Leaves a training for the next exposure and waits for its outcome. From any thread.
  /// @param timeout for the exposure [s]
  TrainingMailbox::Response train(const Training& training, double timeout) { return requests_.ask(training, timeout); }

  /// Thresholds, times and debug options from the next exposure on; all else has to be as it was. From any thread.
  void setSettings(const TrackerParameters& settings);

  QueueDrops drops() const { return arrivals_.drops(); }

private:
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;

  struct Arrival
  {
    sensor_msgs::ImageConstPtr image;
    ros::SteadyTime time;
  };

  void imageCb(const sensor_msgs::ImageConstPtr& image);

  // All below run in the thread.
  void work();
  void configure();
  void makeTracker();
  /// The template that a tracker before this one left behind, if there was one.
  void takeUp();
  /// Keeps the template for a tracker after this one, if it is another one than is kept, or is seen otherwise by now.
  void keep();
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
  void tell(const TrackedRegion& result, const std::string& error);
  /// What people may look at: made after the answer, and only while somebody does.
  void publishResiduals(const sensor_msgs::ImageConstPtr& image, const TrackedRegion& result);

  ros::NodeHandle nh_;
  const std::string name_;
  TrackerStatus& status_;
  BoundedQueue<Arrival> arrivals_;
  TrainingMailbox requests_;
  const sensor_msgs::Image* last_received_ = nullptr;  ///< of the image callback
  ros::Time last_received_stamp_;

  std::mutex settings_mutex_;
  TrackerParameters settings_;
  std::atomic<bool> settings_changed_{ false };

  // The thread's.
  TrackerParameters parameters_;
  std::string configuration_fault_;  ///< of parameters or setup file; empty: none
  IntensityModel intensity_;
  std::optional<ViewTracker> tracker_;       ///< none: the configuration is faulty
  HyperplaneTracker* hyperplane_ = nullptr;  ///< the tracker's, for its thresholds
  sensor_msgs::ImageConstPtr reference_;     ///< that the template was trained on
  std::optional<RestartFile> restart_file_;  ///< none: nothing is kept
  sensor_msgs::ImageConstPtr kept_;          ///< the reference in it
  double kept_usual_ = 0.0;                  ///< ViewTracker::usualUnexplained() in it; 0: none
  ros::SteadyTime kept_at_;
  ros::SteadyTime training_end_;
  StampPolicy stamps_;
  LogThrottle throttle_;
  std::string logged_error_;
  std::uint8_t logged_state_ = TrackedRegion::UNTRAINED;

  ros::Publisher region_publisher_;
  ros::Publisher overlay_publisher_;
  ros::Publisher residuals_publisher_;
  ros::Subscriber image_subscriber_;
  std::thread thread_;
};
}  // namespace xray_tracking
