#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Whether withPixelType() knows the image's pixels.
inline bool isPixelType(const cv::Mat& image)
{
  return image.type() == CV_8UC1 || image.type() == CV_16UC1 || image.type() == CV_32FC1;
}

/// Calls with a value of the image's pixel type: CV_8UC1, CV_16UC1, else CV_32FC1.
template <typename Call>
void withPixelType(const cv::Mat& image, Call&& call)
{
  switch (image.depth())
  {
    case CV_8U:
      call(std::uint8_t{});
      break;
    case CV_16U:
      call(std::uint16_t{});
      break;
    default:
      call(float{});
  }
}
}  // namespace xray_tracking
