#include "xray_tracking_tools/image_message.h"

#include <cstring>

#include <sensor_msgs/image_encodings.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
sensor_msgs::Image imageMessage(const cv::Mat& image, const std::string& detector, const ros::Time& stamp)
{
  CV_Assert(image.type() == CV_16UC1 || image.type() == CV_8UC1);
  sensor_msgs::Image message;
  message.header.stamp = stamp;
  message.header.frame_id = opticalFrame(detector);
  message.encoding =
      image.depth() == CV_8U ? sensor_msgs::image_encodings::MONO8 : sensor_msgs::image_encodings::MONO16;
  message.width = image.cols;
  message.height = image.rows;
  message.step = static_cast<std::uint32_t>(image.cols * image.elemSize());
  message.data.resize(static_cast<std::size_t>(message.step) * message.height);
  for (int row = 0; row < image.rows; ++row)
  {
    std::memcpy(message.data.data() + static_cast<std::size_t>(row) * message.step, image.ptr(row), message.step);
  }
  return message;
}
}  // namespace xray_tracking
