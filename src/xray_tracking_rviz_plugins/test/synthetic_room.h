#pragma once

#include <string>
#include <vector>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <xray_tracking_msgs/TrackedRegion.h>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// A detector that sends what a test has drawn. Its source is 1.5 m from the isocentre along `side` * room y, its panel
/// 0.5 m on the other side; columns run along room x, rows along -z for side = -1.
class SyntheticDetector
{
public:
  static constexpr double kDistance = 2.0;  // [m]
  static constexpr double kPitch = 0.001;   // of 512 pixels [m]

  SyntheticDetector(const std::string& name, int size) : name_(name), pixels_(size, size, CV_16UC1, cv::Scalar(2000))
  {
    image_ = nh_.advertise<sensor_msgs::Image>(name + "/image_raw", 2);
    info_ = nh_.advertise<sensor_msgs::CameraInfo>(name + "/camera_info", 2);
    region_ = nh_.advertise<xray_tracking_msgs::TrackedRegion>(name + "/tracked_region", 2);
    geometry_msgs::TransformStamped transform;
    transform.header.frame_id = "treatment_room";
    transform.child_frame_id = name + "_optical_frame";
    transform.transform.translation.y = -1.5;
    // Columns along x, rows along -z, the ray along y: a quarter turn about x.
    transform.transform.rotation.x = -std::sqrt(0.5);
    transform.transform.rotation.w = std::sqrt(0.5);
    transforms_.sendTransform(transform);
  }

  cv::Mat& pixels() { return pixels_; }

  sensor_msgs::CameraInfo cameraInfo() const
  {
    sensor_msgs::CameraInfo info;
    info.header.frame_id = name_ + "_optical_frame";
    info.width = static_cast<std::uint32_t>(pixels_.cols);
    info.height = static_cast<std::uint32_t>(pixels_.rows);
    info.distortion_model = "plumb_bob";
    info.D.assign(5, 0.0);
    const double f = kDistance / kPitch * pixels_.cols / 512.0, c = 0.5 * (pixels_.cols - 1);
    info.K = { f, 0.0, c, 0.0, f, c, 0.0, 0.0, 1.0 };
    info.R = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    info.P = { f, 0.0, c, 0.0, 0.0, f, c, 0.0, 0.0, 0.0, 1.0, 0.0 };
    return info;
  }

  /// Where a pixel is in the room, from the words above and not from the geometry of the core [m].
  std::vector<double> placeOf(double u, double v) const
  {
    const double pitch = kPitch * 512.0 / pixels_.cols, c = 0.5 * (pixels_.cols - 1);
    return { (u - c) * pitch, kDistance - 1.5, -(v - c) * pitch };
  }

  void send(const ros::Time& stamp) { send(stamp, cameraInfo()); }
  void send(const ros::Time& stamp, sensor_msgs::CameraInfo info)
  {
    info.header.stamp = stamp;
    info_.publish(info);
    sensor_msgs::Image image;
    image.header = info.header;
    image.encoding = "mono16";
    image.width = static_cast<std::uint32_t>(pixels_.cols);
    image.height = static_cast<std::uint32_t>(pixels_.rows);
    image.step = 2 * image.width;
    image.data.assign(pixels_.data, pixels_.data + std::size_t{ image.step } * image.height);
    image_.publish(image);
  }

  void sendRegion(const ros::Time& stamp, const cv::Rect& region, double dx, double dy,
                  std::uint8_t state = xray_tracking_msgs::TrackedRegion::TRACKING)
  {
    xray_tracking_msgs::TrackedRegion message;
    message.header.stamp = stamp;
    message.header.frame_id = name_ + "_optical_frame";
    message.state = state;
    message.region.x_offset = static_cast<std::uint32_t>(region.x);
    message.region.y_offset = static_cast<std::uint32_t>(region.y);
    message.region.width = static_cast<std::uint32_t>(region.width);
    message.region.height = static_cast<std::uint32_t>(region.height);
    message.displacement_x = dx;
    message.displacement_y = dy;
    message.linear = { 1.0, 0.0, 0.0, 1.0 };
    message.correlation = 0.97;
    region_.publish(message);
  }

private:
  std::string name_;
  cv::Mat pixels_;
  ros::NodeHandle nh_;
  ros::Publisher image_, info_, region_;
  tf2_ros::StaticTransformBroadcaster transforms_;
};
}  // namespace xray_tracking
