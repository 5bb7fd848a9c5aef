#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <std_srvs/Trigger.h>
#include <tbb/task_group.h>
#include <tf2_ros/transform_broadcaster.h>

#include "xray_tracking_detector_simulator/detector_simulator.h"

namespace xray_tracking
{
/// The simulated detectors as a node (README.md: topics, service, parameters). The constructor only advertises; loading
/// and computing happen in a thread of its own. Nothing that goes wrong there ends the process: the node stays, says
/// why, and its service `start` answers with the reason.
class DetectorSimulatorRos
{
public:
  DetectorSimulatorRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~DetectorSimulatorRos();

private:
  using Clock = std::chrono::steady_clock;

  enum class State
  {
    LOADING,
    READY,
    RUNNING,
    DONE,
    FAILED
  };

  struct Detector
  {
    ros::Publisher image_publisher;
    ros::Publisher info_publisher;
    sensor_msgs::CameraInfo info;
    sensor_msgs::ImagePtr next_image;
  };

  void run();
  void load();
  /// Computes an exposure into the detectors' next images.
  void prepare(int exposure);
  void publish();
  bool stopped();
  bool waitForStart();
  bool everyImageHasSubscriber() const;
  void runExposures();
  /// @return false if the node is to end
  bool sleepUntil(Clock::time_point time);
  /// The time now, once it differs from the last exposure's. @return false if the node is to end
  bool takeStamp(ros::Time& stamp);
  void reportPace(double seconds_since_last);
  void setState(State state, const std::string& reason = "");

  bool onStart(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);
  void produceDiagnostics(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;

  // Of the worker thread alone.
  double rate_ = 10.0;
  int exposures_ = 0;
  bool wait_for_start_ = false;
  std::unique_ptr<DetectorSimulator> simulator_;
  std::vector<Detector> detectors_;
  std::vector<cv::Mat> images_;  ///< headers on the data of next_image
  RigidTransform next_pose_;
  ros::Time last_stamp_;
  ros::Publisher truth_publisher_;
  tf2_ros::TransformBroadcaster broadcaster_;
  Clock::duration compute_time_{ 0 };

  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  bool start_requested_ = false;
  State state_ = State::LOADING;
  std::string reason_;
  int published_ = 0;
  double achieved_rate_ = 0.0;
  double asked_rate_ = 0.0;
  double compute_seconds_ = 0.0;

  diagnostic_updater::Updater updater_;
  ros::SteadyTimer diagnostics_timer_;
  ros::ServiceServer start_service_;
  tbb::task_group computing_;  ///< all that the worker does, so that its loops on all cores can be cancelled
  std::thread worker_;
};
}  // namespace xray_tracking
