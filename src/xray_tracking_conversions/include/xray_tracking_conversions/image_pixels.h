#pragma once

#include <opencv2/core.hpp>

#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

namespace xray_tracking
{
/// The message's pixels, CV_8UC1 or CV_16UC1 in the machine's order of bytes, whatever the message's; rows may be
/// padded. Not copied where nothing has to be changed: valid as long as the message is.
/// @throws std::invalid_argument naming the field and its value: encodings other than mono8, mono16, 8UC1 and 16UC1, no
/// pixels, rows longer than `step` or more than there is data
cv::Mat pixelsFromMsg(const sensor_msgs::Image& message);

/// The same of a PNG or JPEG image as image_transport sends it; JPEG has 8 bit and is not what the detector saw.
/// @throws std::invalid_argument naming the format: not decodable, or not one channel of 8 or 16 bit
cv::Mat pixelsFromMsg(const sensor_msgs::CompressedImage& message);
}  // namespace xray_tracking
