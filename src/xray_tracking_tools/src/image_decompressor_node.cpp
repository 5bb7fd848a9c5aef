#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include <ros/ros.h>
#include <sensor_msgs/CompressedImage.h>

#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_tools/image_message.h"

namespace xray_tracking
{
namespace
{
void decompress(const sensor_msgs::CompressedImage& message, const std::string& detector,
                const ros::Publisher& publisher)
{
  try
  {
    sensor_msgs::Image image = imageMessage(pixelsFromMsg(message), detector, message.header.stamp);
    image.header = message.header;
    publisher.publish(image);
  }
  catch (const std::invalid_argument& error)
  {
    ROS_ERROR_STREAM_THROTTLE(1.0, detector << "/image_raw/compressed: " << error.what()
                                            << "; the exposure is dropped: look at what compresses them");
  }
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  ros::init(argc, argv, "image_decompressor");
  ros::NodeHandle nh;
  try
  {
    xray_tracking::ParameterReader parameters(ros::NodeHandle("~"));
    const std::vector<std::string> detectors =
        parameters.read("detectors", std::vector<std::string>{ "detector_a", "detector_b" });
    parameters.warnOfUnread();
    std::vector<ros::Publisher> publishers;
    std::vector<ros::Subscriber> subscribers;
    for (const std::string& detector : detectors)
    {
      publishers.push_back(nh.advertise<sensor_msgs::Image>(detector + "/image_raw", 100));
      const boost::function<void(const sensor_msgs::CompressedImageConstPtr&)> callback =
          [detector, publisher = publishers.back()](const sensor_msgs::CompressedImageConstPtr& message)
      { xray_tracking::decompress(*message, detector, publisher); };
      subscribers.push_back(nh.subscribe<sensor_msgs::CompressedImage>(
          detector + "/image_raw/compressed", 100, callback, nullptr, ros::TransportHints().tcpNoDelay()));
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
