#pragma once

#include <string>

#include "noise_spectrum.h"
#include "point_sampler.h"
#include "predictor.h"

namespace xray_tracking
{
/// How well a region's texture fixes a translation, before anything is learnt. Grey values in the sense of the
/// intensity model.
struct ContrastCheck
{
  NoiseSpectrum noise;
  double gradient = 0.0;      ///< rms grey-value change a pixel in the weakest direction, without the noise's share
  double predicted_sd = 0.0;  ///< of the displacement in that direction [px]: Cramer-Rao bound; infinity: no texture
};

/// @param points where the texture is looked at; @param nuisance what is not counted as texture there
/// @param samples number of grey values that the displacement will be estimated from
ContrastCheck checkContrast(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& region,
                            const Points& points, const Nuisance& nuisance, double samples);

/// "width x height at (x, y)"
std::string describe(const cv::Rect& region);
}  // namespace xray_tracking
