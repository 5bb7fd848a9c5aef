#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_tools/graph_connections.h"

namespace xray_tracking
{
/// Makes a run of the graph begin when everybody listens, and end when every exposure is answered.
///
/// Parameters: ~exposures, ~detectors, ~required_subscribers, ~required_detector_subscribers, ~start_mode,
/// ~start_service, ~stall_timeout.
/// Subscribes: patient_motion, <detector>/camera_info, <detector>/tracked_region.
/// Calls: ~start_service (std_srvs/Trigger of a simulator, or std_srvs/SetBool of rosbag play's pause_playback).
/// Its time is the monotonic clock: it has to see a /clock that stands still, and neither that nor a computer whose
/// clock is set is the end of a run.
class RunSupervisorRos
{
public:
  /// @throws std::invalid_argument naming the parameter, its value and what was expected
  RunSupervisorRos(ros::NodeHandle nh, const ros::NodeHandle& pnh);

  /// Handles messages until the run is over or ROS shuts down. @return exit status: 0 if every exposure was answered
  int run();

private:
  /// What came from one detector, by stamp.
  struct DetectorCounts
  {
    std::set<ros::Time> exposures;
    std::set<ros::Time> regions;
    double correlation = 0.0;
  };

  void startWhenConnected();
  std::string callStartService() const;
  void setWaitingFor(const std::string& text);
  void motionCallback(const xray_tracking_msgs::PatientMotion& message);
  void tick();
  void printProgress(const xray_tracking_msgs::PatientMotion& message);
  void printStall();

  std::size_t exposures_;
  double stall_timeout_s_;
  bool playback_;
  std::string start_service_;
  RequiredSubscribers required_subscribers_;
  std::vector<ros::Subscriber> subscribers_;
  ros::SteadyTimer timer_;

  std::map<std::string, DetectorCounts> detectors_;
  std::set<ros::Time> motions_;
  ros::SteadyTime last_event_;  ///< start, or the last new answer
  ros::SteadyTime last_print_;
  int exit_status_ = 1;

  std::atomic<bool> started_{ false };
  bool start_seen_ = false;
  std::mutex waiting_for_mutex_;
  std::string waiting_for_;  ///< what the start waits for
};
}  // namespace xray_tracking
