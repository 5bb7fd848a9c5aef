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

double airCounts(const cv::Mat& image, const IntensityModel& intensity)
{
  double brightest = 0.0;
  if (!intensity.air_counts)
  {
    cv::minMaxLoc(image, nullptr, &brightest);
  }
  return intensity.air_counts.value_or(brightest);
}
}  // namespace xray_tracking
