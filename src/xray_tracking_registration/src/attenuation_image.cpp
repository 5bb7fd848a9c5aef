#include "xray_tracking_registration/attenuation_image.h"

#include <cmath>
#include <stdexcept>
#include <string>

namespace xray_tracking
{
void attenuationImage(const cv::Mat& image, const IntensityModel& intensity, cv::Mat& attenuation)
{
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_16UC1 && image.type() != CV_32FC1))
  {
    throw std::invalid_argument("image: expected one channel of 8 or 16 bit without sign or of float, not empty");
  }
  image.convertTo(attenuation, CV_32F);
  if (!cv::checkRange(attenuation))
  {
    throw std::invalid_argument("image: has values that are not finite");
  }
  if (intensity.kind == IntensityModel::Kind::ATTENUATION)
  {
    return;
  }
  double air = 0.0;
  if (intensity.air_counts)
  {
    air = *intensity.air_counts;
  }
  else
  {
    cv::minMaxLoc(attenuation, nullptr, &air);
  }
  if (!(air > intensity.offset))
  {
    throw std::invalid_argument("intensity: air counts are " + std::to_string(air) +
                                ": expected more than the offset " + std::to_string(intensity.offset));
  }
  attenuation -= intensity.offset;
  cv::max(attenuation, 1.0, attenuation);
  cv::log(attenuation, attenuation);
  attenuation = std::log(air - intensity.offset) - attenuation;
}
}  // namespace xray_tracking
