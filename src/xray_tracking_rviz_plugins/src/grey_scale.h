#pragma once

#include <cstdint>
#include <vector>

#include <sensor_msgs/Image.h>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// The message's pixels, CV_8UC1 or CV_16UC1, not copied where its bytes are in the machine's order; valid as long as
/// the message is. @throws std::invalid_argument saying what is wrong: encodings other than mono8 and mono16, no
/// pixels, rows that are longer than `step` or more than there is data
cv::Mat pixelsOf(const sensor_msgs::ImageConstPtr& image);

/// Pixel values that are shown black and white; low < high.
struct GreyWindow
{
  double low = 0.0;
  double high = 1.0;
  /// Greys in between go by the logarithm of the value (1 and less: 0), as attenuation does; else by the value.
  bool logarithmic = true;

  /// What greys are proportional to.
  double tone(double value) const;
  /// Of it, the value.
  double value(double tone) const;
  /// By as much of the width to brighter or darker, and wider or narrower; each of 1 doubles or halves the width, or
  /// moves by it.
  GreyWindow adjusted(double brighter, double wider) const;
};

/// The window between the 1st and 99th percentile of the pixels, with a margin. A value at an end that many pixels
/// have does not count: blocked field, saturated air. @param pixels CV_8UC1 or CV_16UC1
GreyWindow automaticWindow(const cv::Mat& pixels, bool logarithmic);

/// The automatic window over time: follows slowly, so that noise and what moves do not make the picture flicker.
class WindowFollower
{
public:
  GreyWindow follow(const GreyWindow& automatic);
  void reset() { known_ = false; }

private:
  bool known_ = false;
  GreyWindow window_;
};

/// Pixels to 8 bit grey.
class GreyScale
{
public:
  /// @param pixels CV_8UC1 or CV_16UC1; @param grey out, CV_8UC1 of that size, re-used if it has it
  void convert(const cv::Mat& pixels, const GreyWindow& window, bool inverted, cv::Mat& grey);

private:
  GreyWindow window_;
  bool inverted_ = false;
  std::vector<std::uint8_t> table_;  ///< of all values up to 65535
};
}  // namespace xray_tracking
