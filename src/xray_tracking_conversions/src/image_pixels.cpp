#include "xray_tracking_conversions/image_pixels.h"

#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include <sensor_msgs/image_encodings.h>

namespace xray_tracking
{
namespace
{
bool machineIsBigEndian()
{
  const std::uint16_t one = 1;
  std::uint8_t first = 0;
  std::memcpy(&first, &one, 1);
  return first == 0;
}
/// Whether they are a JPEG, or a PNG that holds the pixels that it claims: of other formats OpenCV would decode, too,
/// and make room for whatever a few bytes claim.
bool mayBeDecoded(const std::vector<std::uint8_t>& data)
{
  constexpr std::size_t kSizeAt = 16;  // in a PNG: columns and rows
  if (data.size() < kSizeAt + 8)
  {
    return false;
  }
  if (data[0] == 0xFF && data[1] == 0xD8)
  {
    return true;
  }
  const auto number = [&](std::size_t at)
  { return data[at] * 16777216.0 + data[at + 1] * 65536.0 + data[at + 2] * 256.0 + data[at + 3]; };
  constexpr double kMostPacked = 1032.0;  // deflate's
  constexpr double kSmall = 1 << 24;      // pixels
  constexpr double kLargest = 16384.0;    // columns and rows
  return std::memcmp(data.data(), "\x89PNG", 4) == 0 && number(kSizeAt) <= kLargest &&
         number(kSizeAt + 4) <= kLargest &&
         number(kSizeAt) * number(kSizeAt + 4) <= kSmall + kMostPacked * static_cast<double>(data.size());
}
}  // namespace

cv::Mat pixelsFromMsg(const sensor_msgs::Image& message)
{
  namespace encodings = sensor_msgs::image_encodings;
  const std::string& encoding = message.encoding;
  const bool wide = encoding == encodings::MONO16 || encoding == encodings::TYPE_16UC1;
  if (!wide && encoding != encodings::MONO8 && encoding != encodings::TYPE_8UC1)
  {
    throw std::invalid_argument("image.encoding is '" + encoding + "', expected mono16, mono8, 16UC1 or 8UC1");
  }
  constexpr std::uint32_t kLargest = 1 << 16;
  const std::size_t row = std::size_t{ message.width } * (wide ? 2 : 1);
  if (message.width == 0 || message.height == 0 || message.width > kLargest || message.height > kLargest ||
      message.step < row || message.data.size() < std::size_t{ message.step } * (message.height - 1) + row)
  {
    throw std::invalid_argument("image is " + std::to_string(message.width) + " x " + std::to_string(message.height) +
                                " pixels in " + std::to_string(message.data.size()) + " bytes, step " +
                                std::to_string(message.step) + ": expected as many bytes as that takes");
  }
  const int type = wide ? CV_16UC1 : CV_8UC1;
  const cv::Size size(static_cast<int>(message.width), static_cast<int>(message.height));
  const bool swapped = wide && (message.is_bigendian != 0) != machineIsBigEndian();
  if (!swapped && (!wide || message.step % 2 == 0))
  {
    // OpenCV takes no const buffer; nobody writes to what comes from a message.
    return { size, type, const_cast<std::uint8_t*>(message.data.data()), message.step };
  }
  cv::Mat pixels(size, type);
  for (int y = 0; y < size.height; ++y)
  {
    const std::uint8_t* const from = message.data.data() + std::size_t{ message.step } * static_cast<std::size_t>(y);
    auto* const to = pixels.ptr<std::uint8_t>(y);
    for (std::size_t n = 0; n < row; ++n)
    {
      to[n] = from[swapped ? n ^ 1u : n];
    }
  }
  return pixels;
}

cv::Mat pixelsFromMsg(const sensor_msgs::CompressedImage& message)
{
  cv::Mat pixels;
  try
  {
    if (mayBeDecoded(message.data))
    {
      pixels = cv::imdecode(message.data, cv::IMREAD_UNCHANGED);
    }
  }
  catch (const cv::Exception&)
  {
    pixels.release();
  }
  if (pixels.type() != CV_8UC1 && pixels.type() != CV_16UC1)
  {
    pixels.release();
  }
  if (pixels.empty())
  {
    throw std::invalid_argument(
        "compressed image.format is '" + message.format + "', of " + std::to_string(message.data.size()) +
        " bytes: expected a PNG or JPEG image of one channel of 8 or 16 bit, of 16384 x 16384 pixels at most");
  }
  return pixels;
}
}  // namespace xray_tracking
