#pragma once

#include <opencv2/core.hpp>

#include "xray_tracking_registration/attenuation_image.h"

namespace xray_tracking
{
/// A part of an image in bins, of what is usable alone.
struct BinnedImage
{
  cv::Mat mean;   ///< CV_32FC1; of a bin without a usable pixel 0
  cv::Mat share;  ///< of a bin's pixels that are usable, CV_32FC1; empty if all of all bins are
};

/// @param usable CV_8UC1 of the image's size, 0 for pixels that do not count; empty: all do
/// @param bins of the image, inside of it
/// @param edge of a bin [px]
BinnedImage binned(const AttenuationImage& attenuation, const cv::Mat& usable, const cv::Rect& bins, int edge);
}  // namespace xray_tracking
