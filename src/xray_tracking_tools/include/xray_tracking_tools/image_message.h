#pragma once

#include <string>

#include <ros/time.h>
#include <sensor_msgs/Image.h>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// A detector's image as its driver would publish it: `mono16`, rows without padding, in the detector's optical frame.
/// @param image CV_16UC1
sensor_msgs::Image imageMessage(const cv::Mat& image, const std::string& detector, const ros::Time& stamp);
}  // namespace xray_tracking
