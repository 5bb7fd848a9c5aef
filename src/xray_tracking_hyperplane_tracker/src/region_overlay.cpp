#include "xray_tracking_hyperplane_tracker/region_overlay.h"

#include <algorithm>

#include <opencv2/imgproc.hpp>

#include "point_sampler.h"

namespace xray_tracking
{
cv::Mat drawRegionOverlay(const cv::Mat& image, const RegionOverlay& overlay)
{
  checkImage(image);
  constexpr double kWindow = 3.0;  // standard deviations to either side
  const cv::Rect seen = overlay.reference & cv::Rect(cv::Point(), image.size());
  cv::Scalar mean, deviation;
  cv::meanStdDev(seen.empty() ? image : image(seen), mean, deviation);
  const double scale = 127.5 / std::max(1.0, kWindow * deviation[0]);
  cv::Mat grey, picture;
  image.convertTo(grey, CV_8U, scale, 127.5 - scale * mean[0]);
  cv::cvtColor(grey, picture, cv::COLOR_GRAY2BGR);
  if (overlay.reference.empty())
  {
    return picture;
  }
  cv::rectangle(picture, overlay.reference, overlay.displacement ? cv::Scalar(160, 160, 160) : overlay.colour);
  if (overlay.displacement)
  {
    const cv::Point shift(cvRound(overlay.displacement->x()), cvRound(overlay.displacement->y()));
    cv::rectangle(picture, overlay.reference + shift, overlay.colour, 2);
  }
  return picture;
}
}  // namespace xray_tracking
