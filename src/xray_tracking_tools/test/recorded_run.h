#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <utility>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinedPose.h>

namespace xray_tracking
{
/// Writes what a run would have recorded. Positions in mm; no rotations.
class RecordedRun
{
public:
  explicit RecordedRun(const std::string& path, std::string method = "tracking")
    : method_(std::move(method)), bag_(path, rosbag::bagmode::Write)
  {
  }

  void motion(const ros::Time& stamp, int state, const std::string& reason = "")
  {
    xray_tracking_msgs::PatientMotion message;
    message.header.stamp = stamp;
    message.state = static_cast<std::uint8_t>(state);
    message.reason = reason;
    message.method = method_;
    message.cpu_time = ros::Duration(0.002);
    message.wall_time = ros::Duration(0.003);
    bag_.write("/patient_motion", stamp, message);
  }
  void pose(const ros::Time& stamp, double x, double y, double z)
  {
    geometry_msgs::PoseWithCovarianceStamped message;
    message.header.stamp = stamp;
    message.pose.pose = poseMessage(x, y, z);
    bag_.write("/patient_pose", stamp, message);
  }
  void gate(const ros::Time& exposure, bool verified, int reason, const std::string& text = "")
  {
    xray_tracking_msgs::BeamGate message;
    message.header.stamp = exposure + ros::Duration(0.02);
    message.exposure = exposure;
    message.reason = reason;
    message.verified = verified;
    message.open = reason == xray_tracking_msgs::BeamGate::NONE;
    message.text = text;
    bag_.write("/beam_gate", message.header.stamp, message);
  }
  /// An exposure that was answered well.
  void answer(const ros::Time& stamp, double x, double y, double z)
  {
    motion(stamp, xray_tracking_msgs::PatientMotion::OK);
    pose(stamp, x, y, z);
    gate(stamp, true, xray_tracking_msgs::BeamGate::NONE);
  }
  void refined(const ros::Time& stamp, int status, double x, double y, double z)
  {
    xray_tracking_msgs::RefinedPose message;
    message.header.stamp = stamp;
    message.result.status = status;
    message.result.reason = "status " + std::to_string(status);
    message.result.pose.pose = poseMessage(x, y, z);
    message.cpu_time = ros::Duration(0.03);
    message.wall_time = ros::Duration(0.02);
    bag_.write("/refined_pose", stamp, message);
  }
  void truth(const ros::Time& stamp, double x, double y, double z)
  {
    geometry_msgs::PoseStamped message;
    message.header.stamp = stamp;
    message.pose = poseMessage(x, y, z);
    bag_.write("/patient_ground_truth", stamp, message);
  }
  void exposure(const ros::Time& stamp)
  {
    sensor_msgs::CameraInfo message;
    message.header.stamp = stamp;
    bag_.write("/detector_a/camera_info", stamp, message);
  }
  void close() { bag_.close(); }

private:
  static geometry_msgs::Pose poseMessage(double x, double y, double z)
  {
    geometry_msgs::Pose pose;
    pose.position.x = 1e-3 * x;
    pose.position.y = 1e-3 * y;
    pose.position.z = 1e-3 * z;
    pose.orientation.w = 1.0;
    return pose;
  }

  std::string method_;
  rosbag::Bag bag_;
};

/// A live run of six exposures, one a second from 50 s on; truth: k mm along x. Errors of frames 1 and 2: 0.5 mm
/// (0.3, 0.4, 0) and 2 mm (0, 0, -2); 3 lost, 4 without an answer, 5 inconsistent.
inline void writeTestRun(const std::string& path)
{
  using xray_tracking_msgs::PatientMotion;
  RecordedRun run(path);
  for (int k = 0; k < 6; ++k)
  {
    run.truth(ros::Time(50 + k, 0), k, 0, 0);
  }
  run.answer(ros::Time(50, 0), 0, 0, 0);
  run.answer(ros::Time(51, 0), 1.3, 0.4, 0);
  run.answer(ros::Time(52, 0), 2, 0, -2);
  run.motion(ros::Time(53, 0), PatientMotion::LOST, "detector_b lost its region");
  run.motion(ros::Time(55, 0), PatientMotion::INCONSISTENT, "the views disagree by 9 px");
  run.close();
}
}  // namespace xray_tracking
