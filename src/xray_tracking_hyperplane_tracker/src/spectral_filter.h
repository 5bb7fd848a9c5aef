#pragma once

#include <opencv2/core.hpp>

#include "noise_spectrum.h"

namespace xray_tracking
{
/// What a template's noise and surroundings are reckoned to be.
struct DifferenceModel
{
  NoiseSpectrum noise;      ///< of one image
  double background = 0.0;  ///< variance of the differences that an overlay moving on its own makes
};

/// The image without noise, as well as the spectra of blocks of 16 px, averaged over directions, tell both apart
/// (Wiener). Noise in derivatives would answer to itself and make all other answers seem too small; not where edges
/// are, which outweigh it, but where the fit has to do without edges.
/// @param image CV_32FC1
cv::Mat withoutNoise(const cv::Mat& image, const NoiseSpectrum& noise);

/// Filters images by the inverse of a covariance: noise plus a background with the spectrum 1/f^3.
class Whitening
{
public:
  /// @param size of the images; @param step distance of their pixels [px]
  /// @param model whose background may be zero
  Whitening(const cv::Size& size, int step, const DifferenceModel& model);

  cv::Mat operator()(const cv::Mat& image) const;

private:
  cv::Mat weights_;
};
}  // namespace xray_tracking
