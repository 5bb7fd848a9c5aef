#include "xray_tracking_registration/attenuation_image.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

namespace xray_tracking
{
namespace
{
template <typename Value, typename Map>
cv::Mat mapped(const cv::Mat& image, const Map& map)
{
  cv::Mat result(image.size(), CV_32FC1);
  for (int row = 0; row < image.rows; ++row)
  {
    const Value* from = image.ptr<Value>(row);
    std::transform(from, from + image.cols, result.ptr<float>(row), map);
  }
  return result;
}
}  // namespace

AttenuationImage::AttenuationImage(const cv::Mat& image, const IntensityModel& intensity)
  : image_(image), counts_(intensity.kind == IntensityModel::Kind::COUNTS)
{
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_16UC1 && image.type() != CV_32FC1))
  {
    throw std::invalid_argument("image: expected one channel of 8 or 16 bit without sign or of float, not empty");
  }
  if (!cv::checkRange(image))
  {
    throw std::invalid_argument("image: has values that are not finite");
  }
  if (!counts_)
  {
    return;
  }
  double largest = std::numeric_limits<std::uint8_t>::max();
  if (image.depth() != CV_8U || !intensity.air_counts)
  {
    cv::minMaxLoc(image, nullptr, &largest);
  }
  offset_ = intensity.offset;
  air_ = intensity.air_counts.value_or(largest);
  if (!(air_ > offset_))
  {
    throw std::invalid_argument("intensity: air counts are " + std::to_string(air_) +
                                ": expected more than the offset " + std::to_string(offset_));
  }
  if (image.depth() != CV_32F)
  {
    // As many logarithms as there are values, not pixels.
    table_.resize(static_cast<std::size_t>(largest) + 1);
    for (std::size_t counts = 0; counts < table_.size(); ++counts)
    {
      table_[counts] = attenuationOf(static_cast<double>(counts));
    }
  }
}

float AttenuationImage::attenuationOf(double counts) const
{
  return static_cast<float>(std::log((air_ - offset_) / std::max(counts - offset_, 1.0)));
}

cv::Mat AttenuationImage::operator()(const cv::Rect& part) const
{
  const cv::Mat image = image_(part);
  if (!counts_)
  {
    cv::Mat attenuation;
    image.convertTo(attenuation, CV_32F);
    return attenuation;
  }
  const auto look_up = [this](std::size_t counts) { return table_[counts]; };
  switch (image.depth())
  {
    case CV_8U:
      return mapped<std::uint8_t>(image, look_up);
    case CV_16U:
      return mapped<std::uint16_t>(image, look_up);
    default:
      return mapped<float>(image, [this](float counts) { return attenuationOf(counts); });
  }
}
}  // namespace xray_tracking
