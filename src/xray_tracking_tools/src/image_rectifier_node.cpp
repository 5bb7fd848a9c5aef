#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <message_filters/subscriber.h>
#include <message_filters/time_synchronizer.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_core/image/lens_distortion.h"
#include "xray_tracking_core/option_check.h"
#include "xray_tracking_tools/image_message.h"

namespace xray_tracking
{
namespace
{
constexpr double kAnyDistance = 1000.0;  // K alone says what a distortion does

/// Undoes one detector's distortion, as its camera_info states it.
class Rectifier
{
public:
  Rectifier(ros::NodeHandle& nh, const std::string& detector, IntensityModel::Kind kind)
    : detector_(detector),
      kind_(kind),
      image_publisher_(nh.advertise<sensor_msgs::Image>(detector + "/image_raw", 100)),
      info_publisher_(nh.advertise<sensor_msgs::CameraInfo>(detector + "/camera_info", 100)),
      image_(nh, detector + "/distorted/image_raw", 100, ros::TransportHints().tcpNoDelay()),
      info_(nh, detector + "/distorted/camera_info", 100, ros::TransportHints().tcpNoDelay()),
      exposures_(image_, info_, 100)
  {
    exposures_.registerCallback(std::bind(&Rectifier::rectify, this, std::placeholders::_1, std::placeholders::_2));
  }

private:
  void rectify(const sensor_msgs::ImageConstPtr& message, const sensor_msgs::CameraInfoConstPtr& info)
  {
    try
    {
      follow(*info);
      const cv::Mat pixels = pixelsFromMsg(*message);
      if (pixels.cols != static_cast<int>(info->width) || pixels.rows != static_cast<int>(info->height))
      {
        throw std::invalid_argument("image is " + std::to_string(pixels.cols) + " x " + std::to_string(pixels.rows) +
                                    ": expected camera_info's " + std::to_string(info->width) + " x " +
                                    std::to_string(info->height));
      }
      sensor_msgs::Image image = imageMessage(distortion_.undo(pixels, kind_), detector_, message->header.stamp);
      image.header = message->header;
      image_publisher_.publish(image);
      straight_.header = info->header;
      info_publisher_.publish(straight_);
    }
    catch (const std::invalid_argument& error)
    {
      ROS_ERROR_STREAM_THROTTLE(1.0, detector_ << "/distorted: " << error.what()
                                               << "; the exposure is dropped: look at the detector's driver");
    }
  }

  /// @throws std::invalid_argument naming the field
  void follow(const sensor_msgs::CameraInfo& info)
  {
    if (known_ && info.K == known_->K && info.D == known_->D && info.distortion_model == known_->distortion_model &&
        info.R == known_->R && info.width == known_->width && info.height == known_->height &&
        info.binning_x == known_->binning_x && info.binning_y == known_->binning_y && info.roi == known_->roi)
    {
      return;
    }
    known_.reset();
    sensor_msgs::CameraInfo straight = info;
    straight.D.clear();
    straight.P.fill(0.0);  // whatever it says: what comes out is by K
    const ProjectionGeometry geometry =
        geometryFromCameraInfo(detector_, straight, RigidTransform::Identity(), kAnyDistance);
    distortion_ = info.D.empty() ? LensDistortion() : LensDistortion(info.distortion_model, info.D, geometry);
    straight_ = cameraInfoFromGeometry(geometry);
    known_ = info;
  }

  const std::string detector_;
  const IntensityModel::Kind kind_;
  std::optional<sensor_msgs::CameraInfo> known_;  ///< of which the two below are
  LensDistortion distortion_;
  sensor_msgs::CameraInfo straight_;
  ros::Publisher image_publisher_;
  ros::Publisher info_publisher_;
  message_filters::Subscriber<sensor_msgs::Image> image_;
  message_filters::Subscriber<sensor_msgs::CameraInfo> info_;
  message_filters::TimeSynchronizer<sensor_msgs::Image, sensor_msgs::CameraInfo> exposures_;
};
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  using xray_tracking::IntensityModel;
  ros::init(argc, argv, "image_rectifier");
  ros::NodeHandle nh;
  try
  {
    xray_tracking::ParameterReader parameters(ros::NodeHandle("~"));
    const std::string kind = parameters.read("intensity/kind", std::string("counts"));
    xray_tracking::requireOption(kind == "counts" || kind == "attenuation", "intensity/kind", "'" + kind + "'",
                                 "counts or attenuation");
    const std::vector<std::string> detectors =
        parameters.read("detectors", std::vector<std::string>{ "detector_a", "detector_b" });
    parameters.warnOfUnread();
    std::vector<std::unique_ptr<xray_tracking::Rectifier>> rectifiers;
    for (const std::string& detector : detectors)
    {
      rectifiers.push_back(std::make_unique<xray_tracking::Rectifier>(
          nh, detector, kind == "counts" ? IntensityModel::Kind::COUNTS : IntensityModel::Kind::ATTENUATION));
    }
    ros::spin();
  }
  catch (const std::exception& error)  // of parameters, or names that no topic may have
  {
    ROS_FATAL_STREAM(error.what());
    return 1;
  }
  return 0;
}
