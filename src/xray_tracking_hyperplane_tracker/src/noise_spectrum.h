#pragma once

#include <array>
#include <cmath>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Noise of an image as a stationary field: its power by spatial frequency, the same in all directions. A frequency's
/// power is the variance of a coefficient of an orthonormal transform there: constant, the pixels' variance, where the
/// noise is white.
class NoiseSpectrum
{
public:
  /// White noise. @param deviation standard deviation
  explicit NoiseSpectrum(double deviation = 0.0) { power_.fill(deviation * deviation); }

  /// Estimates the spectrum from an image with structure: the median, over blocks of 16 px, of the squared coefficients
  /// of their cosine transforms (Ponomarenko et al. 2007), as edges are in few of them. Structure without gaps cannot
  /// be told from noise; it is slow, so below 0.17 cycles a pixel the power is taken to be that there: detectors, which
  /// blur noise as all else, make it flat.
  /// @param values CV_32FC1; @param usable CV_8UC1, 0: a pixel that tells nothing of noise, saturated for one; blocks
  ///        with such pixels are left out. A block's zero coefficients, of quantised flatness, are as well
  /// @param least power that there is at least, the quantisation's
  NoiseSpectrum(const cv::Mat& values, const cv::Mat& usable, double least);

  /// @param f spatial frequency [cycles / px]
  double power(double f) const;
  /// Of noise in an image of which only every `step`-th row and column is taken: frequencies fold.
  /// @param u, v spatial frequencies [cycles / step]
  double foldedPower(double u, double v, int step) const;
  /// Variance of a pixel after a filter. @param gain of two frequencies [cycles / px]
  template <typename Gain>
  double variance(const Gain& gain) const
  {
    constexpr int kSteps = 32;
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i)
    {
      for (int j = 0; j < kSteps; ++j)
      {
        const double u = 0.5 * (i + 0.5) / kSteps;
        const double v = 0.5 * (j + 0.5) / kSteps;
        const double g = gain(u, v);
        sum += g * g * power(std::hypot(u, v));
      }
    }
    return sum / (kSteps * kSteps);
  }
  double variance() const
  {
    return variance([](double, double) { return 1.0; });
  }
  /// Of slow noise, beside which a region's texture has to stand out; the pixels' variance if the noise is white.
  double slowPower() const { return power(0.0); }
  /// Of means over squares of pixels. @param edge [px]
  double varianceOfMeans(int edge) const;

private:
  static constexpr int kBands = 24;
  static constexpr double kBandWidth = 1.0 / 32.0;  ///< [cycles / px]

  std::array<double, kBands> power_;
};

/// Pixels that are not at an end of the range in which the detector answers: 255, else 0. That is, brighter than the
/// offset, and not as bright as full scale or at a plateau of the image's greatest or smallest value.
/// @param image CV_8UC1 or CV_16UC1; @param part of it
cv::Mat unsaturated(const cv::Mat& image, const cv::Rect& part, const IntensityModel& intensity);

/// Distance of neighbouring grey values, 1 or more; more where an image has been made of fewer bits.
/// @param image CV_8UC1 or CV_16UC1
double greyStep(const cv::Mat& image);
}  // namespace xray_tracking
