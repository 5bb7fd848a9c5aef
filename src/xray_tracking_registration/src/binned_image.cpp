#include "binned_image.h"

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
BinnedImage binned(const AttenuationImage& attenuation, const cv::Mat& usable, const cv::Rect& bins, int edge)
{
  const cv::Rect pixels(bins.tl() * edge, bins.size() * edge);
  BinnedImage image;
  if (usable.empty() || cv::countNonZero(usable(pixels)) == pixels.area())
  {
    cv::resize(attenuation(pixels), image.mean, bins.size(), 0.0, 0.0, cv::INTER_AREA);
    return image;
  }
  cv::Mat used;
  cv::Mat weight;
  attenuation(pixels).copyTo(used, usable(pixels));
  cv::Mat(usable(pixels) != 0).convertTo(weight, CV_32F, 1.0 / 255.0);
  cv::resize(used, image.mean, bins.size(), 0.0, 0.0, cv::INTER_AREA);
  cv::resize(weight, image.share, bins.size(), 0.0, 0.0, cv::INTER_AREA);
  image.mean /= cv::max(image.share, 1e-3);
  return image;
}
}  // namespace xray_tracking
