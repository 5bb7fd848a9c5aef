#include "grey_scale.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "xray_tracking_conversions/image_pixels.h"

namespace xray_tracking
{
namespace
{
constexpr int kSamples = 128;       // a row and column, at least
constexpr double kLowShare = 0.01;  // percentiles
constexpr double kHighShare = 0.99;
constexpr double kMargin = 0.05;      // of the width, at either end
constexpr double kManyPixels = 0.02;  // with one value at an end
constexpr double kFewPixels = 0.1;    // so many have to be left without those
constexpr double kFollowing = 0.15;   // of the way, an image

template <typename Value>
void sampleInto(const cv::Mat& pixels, int step, std::vector<int>& values)
{
  for (int row = 0; row < pixels.rows; row += step)
  {
    const Value* from = pixels.ptr<Value>(row);
    for (int column = 0; column < pixels.cols; column += step)
    {
      values.push_back(from[column]);
    }
  }
}

template <typename Value>
void lookUp(const cv::Mat& pixels, const std::vector<std::uint8_t>& table, cv::Mat& grey)
{
  for (int row = 0; row < pixels.rows; ++row)
  {
    const Value* from = pixels.ptr<Value>(row);
    std::uint8_t* to = grey.ptr<std::uint8_t>(row);
    for (int column = 0; column < pixels.cols; ++column)
    {
      to[column] = table[from[column]];
    }
  }
}
}  // namespace

cv::Mat pixelsOf(const sensor_msgs::ImageConstPtr& image)
{
  constexpr std::uint32_t kLargest = 16384;
  if (image->width > kLargest || image->height > kLargest ||
      image->data.size() < std::size_t{ image->step } * image->height)
  {
    throw std::invalid_argument("the image has " + std::to_string(image->width) + " x " +
                                std::to_string(image->height) + " pixels in " + std::to_string(image->data.size()) +
                                " bytes, " + std::to_string(image->step) +
                                " a row: expected 1 to 16384 each way and as many bytes");
  }
  return pixelsFromMsg(*image);
}

double GreyWindow::tone(double value) const
{
  return logarithmic ? std::log(std::max(value, 1.0)) : value;
}

double GreyWindow::value(double tone) const
{
  return logarithmic ? std::exp(tone) : tone;
}

GreyWindow GreyWindow::adjusted(double brighter, double wider) const
{
  const double least = logarithmic ? 0.05 : 1.0;  // width
  const double bottom = tone(0.0), top = tone(65535.0);
  const double width = tone(high) - tone(low);
  const double new_width = std::clamp(width * std::exp2(std::clamp(wider, -8.0, 8.0)), least, 2.0 * (top - bottom));
  const double level = std::clamp(0.5 * (tone(low) + tone(high)) - brighter * width, bottom, top);
  return { value(level - 0.5 * new_width), value(level + 0.5 * new_width), logarithmic };
}

GreyWindow automaticWindow(const cv::Mat& pixels, bool logarithmic)
{
  const int step = std::max(1, std::min(pixels.rows, pixels.cols) / kSamples);
  std::vector<int> values;
  values.reserve(static_cast<std::size_t>((pixels.rows / step + 1) * (pixels.cols / step + 1)));
  if (pixels.depth() == CV_8U)
  {
    sampleInto<std::uint8_t>(pixels, step, values);
  }
  else
  {
    sampleInto<std::uint16_t>(pixels, step, values);
  }
  std::sort(values.begin(), values.end());
  auto first = values.begin(), last = values.end();
  const auto many = static_cast<std::ptrdiff_t>(kManyPixels * static_cast<double>(values.size()));
  const auto few = static_cast<std::ptrdiff_t>(kFewPixels * static_cast<double>(values.size()));
  if (const auto above = std::upper_bound(first, last, *first);
      above - first > many && last - above > few && *above != *(last - 1))
  {
    first = above;
  }
  if (const auto below = std::lower_bound(first, last, *(last - 1));
      last - below > many && below - first > few && *(below - 1) != *first)
  {
    last = below;
  }
  const auto at = [&](double share) { return static_cast<double>(first[std::lround(share * (last - first - 1))]); };
  GreyWindow window{ at(kLowShare), std::max(at(kHighShare), at(kLowShare) + 1.0), logarithmic };
  const double low = window.tone(window.low), high = std::max(window.tone(window.high), low + 1e-3);
  const double margin = kMargin * (high - low);
  return { window.value(low - margin), window.value(high + margin), logarithmic };
}

GreyWindow WindowFollower::follow(const GreyWindow& automatic)
{
  const double width = window_.tone(window_.high) - window_.tone(window_.low);
  const double new_width = automatic.tone(automatic.high) - automatic.tone(automatic.low);
  const bool elsewhere = !known_ || automatic.logarithmic != window_.logarithmic || automatic.low > window_.high ||
                         automatic.high < window_.low || new_width > 2.0 * width || 2.0 * new_width < width;
  const double share = elsewhere ? 1.0 : kFollowing;
  window_.logarithmic = automatic.logarithmic;
  window_.low += share * (automatic.low - window_.low);
  window_.high += share * (automatic.high - window_.high);
  known_ = true;
  return window_;
}

void GreyScale::convert(const cv::Mat& pixels, const GreyWindow& window, bool inverted, cv::Mat& grey)
{
  if (table_.empty() || window.low != window_.low || window.high != window_.high ||
      window.logarithmic != window_.logarithmic || inverted != inverted_)
  {
    window_ = window;
    inverted_ = inverted;
    table_.resize(65536);
    const double low = window.tone(window.low);
    const double scale = 255.0 / std::max(window.tone(window.high) - low, 1e-6);
    for (std::size_t value = 0; value < table_.size(); ++value)
    {
      const auto grey_value = static_cast<std::uint8_t>(
          std::lround(std::clamp((window.tone(static_cast<double>(value)) - low) * scale, 0.0, 255.0)));
      table_[value] = inverted ? static_cast<std::uint8_t>(255 - grey_value) : grey_value;
    }
  }
  grey.create(pixels.size(), CV_8UC1);
  if (pixels.depth() == CV_8U)
  {
    lookUp<std::uint8_t>(pixels, table_, grey);
  }
  else
  {
    lookUp<std::uint16_t>(pixels, table_, grey);
  }
}
}  // namespace xray_tracking
