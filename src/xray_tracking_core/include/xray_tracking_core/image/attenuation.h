#pragma once

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Pixel values in the sense of the intensity model, bright bone: of counts -log(counts - offset), of one at least,
/// which is the attenuation but for a constant.
/// @param image one channel, of any depth. @return of its size, CV_32FC1
cv::Mat attenuationImage(const cv::Mat& image, const IntensityModel& intensity);

/// Counts behind air alone, offset included: as the intensity model states them, or, estimated, those of the image's
/// brightest pixel. @param image one channel, of any depth
double airCounts(const cv::Mat& image, const IntensityModel& intensity);
}  // namespace xray_tracking
