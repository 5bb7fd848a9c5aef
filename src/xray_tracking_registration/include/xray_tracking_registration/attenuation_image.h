#pragma once

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// An X-ray image as attenuation, the line integrals that a DRR holds: for counts -log((I - offset) / (air - offset)),
/// counts below offset + 1 taken as that; for attenuation images the values themselves. Without `air_counts` the
/// image's largest value stands for air, which adds a constant that no similarity here depends on.
/// @param image CV_8UC1, CV_16UC1 or CV_32FC1
/// @param attenuation out, CV_32FC1, of the image's size; re-used if it has that size
/// @throws std::invalid_argument for another type, an empty image, a value that is not finite, or an offset that is not
///         below the air counts
void attenuationImage(const cv::Mat& image, const IntensityModel& intensity, cv::Mat& attenuation);
}  // namespace xray_tracking
