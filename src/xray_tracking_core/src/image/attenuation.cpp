#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
cv::Mat attenuationImage(const cv::Mat& image, const IntensityModel& intensity)
{
  cv::Mat values;
  image.convertTo(values, CV_32F);
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    values = cv::max(values - intensity.offset, 1.0);
    cv::log(values, values);
    values = -values;
  }
  return values;
}
}  // namespace xray_tracking
