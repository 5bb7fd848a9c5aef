#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/ros.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <visualization_msgs/MarkerArray.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_core/sequence/stamp_policy.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Puts a setup file's treatment room on tf, into RViz and into recordings.
///
/// Parameters: ~setup_file (path), ~trail_length (exposures).
/// Publishes: treatment_room_markers (visualization_msgs/MarkerArray, latched); run_description (std_msgs/String,
///   latched; recording.h) with the setup and all parameters; static tf treatment_room -> <detector>_optical_frame and
///   patient -> target.
/// Subscribes: patient_pose, <detector>/tracked_region, beam_gate.
/// With a bad parameter it says so and stays idle.
class TreatmentRoomPublisherRos
{
public:
  TreatmentRoomPublisherRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);

private:
  /// What a tracker has said last.
  struct Region
  {
    std::vector<visualization_msgs::Marker> markers;
    ros::SteadyTime arrival;
    bool old = false;  ///< and shown so
  };

  void start(const ros::NodeHandle& pnh);
  void poseCallback(const geometry_msgs::PoseWithCovarianceStamped& message);
  void regionCallback(std::size_t detector, const xray_tracking_msgs::TrackedRegion& message);
  void gateCallback(const xray_tracking_msgs::BeamGate& message);
  void showGate(bool open, const std::string& why);
  void publishMarkers();

  ros::NodeHandle nh_;
  TreatmentSetup setup_;
  std::size_t trail_length_ = 0;

  std::vector<visualization_msgs::Marker> static_markers_;
  std::map<std::size_t, Region> regions_;  // by detector
  std::vector<geometry_msgs::Point> trail_;
  StampPolicy pose_stamps_;
  visualization_msgs::Marker gate_marker_;
  ros::SteadyTime last_gate_;
  bool changed_ = true;

  tf2_ros::StaticTransformBroadcaster broadcaster_;
  ros::Publisher description_publisher_;
  ros::Publisher marker_publisher_;
  ros::WallTimer timer_;
  ros::Subscriber pose_subscriber_;
  ros::Subscriber gate_subscriber_;
  std::vector<ros::Subscriber> region_subscribers_;
};
}  // namespace xray_tracking
