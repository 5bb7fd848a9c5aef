#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Means over square bins of pixels.
struct BinnedImage
{
  cv::Mat values;    ///< CV_32FC1
  cv::Point corner;  ///< the first pixel of the first bin, in the whole image [px]
  int bin = 1;       ///< edge [px]

  /// The middle of a bin in the whole image [px].
  Eigen::Vector2d place(double column, double row) const
  {
    return Eigen::Vector2d(corner.x, corner.y) + bin * Eigen::Vector2d(column + 0.5, row + 0.5) -
           Eigen::Vector2d(0.5, 0.5);
  }
};

/// @param image CV_32FC1; what is left of it right and below after the last whole bin is not used
/// @param corner of the image in the whole one [px]
BinnedImage binned(const cv::Mat& image, const cv::Point& corner, int bin);

/// Standard deviation of the Gaussian that sharpPart() smooths with [px]: noise goes, bone edges hardly suffer.
constexpr double kSmoothing = 2.0;

/// Attenuation without most noise and slow shading (the mean over a box of 17 px), of a part of an image; CV_32FC1.
cv::Mat sharpPart(const cv::Mat& image, const cv::Rect& part, const IntensityModel& intensity);

/// Displacement of a region's centre [px] and rotation about it [rad].
using PlanarRigidMotion = Eigen::Vector3d;

/// Bilinear values of `image` where the motion takes the bins of `reference`; outside the values of its border.
/// @param centre of the region [px]; @param image with the reference's bin
/// @param moved out, CV_32FC1 of the reference's size
void sampleMoved(const BinnedImage& reference, const Eigen::Vector2d& centre, const PlanarRigidMotion& motion,
                 const BinnedImage& image, cv::Mat& moved);
}  // namespace xray_tracking
