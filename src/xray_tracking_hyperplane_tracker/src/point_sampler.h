#pragma once

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "kernels.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
using Points = Eigen::Matrix<float, Eigen::Dynamic, 2>;  ///< x, y a row [px]
using Box = Eigen::AlignedBox2f;

/// @throws std::invalid_argument unless the image is CV_8UC1 or CV_16UC1 and not empty
void checkImage(const cv::Mat& image);

enum class Sampling
{
  BILINEAR,
  SPLINE  ///< sampleSpline()
};

/// Samples the image between pixels at the mapped points; points outside the image get the value at its nearest border.
/// @param box around the points [px]
/// @param values out, in the sense of the intensity model (attenuation, or -log of the counts less the offset, which is
///        clamped to 1 count or more); of the points' number
/// @param outside out, 1 where the point is outside, else 0; valid if the returned number is not zero
/// @return number of points outside
int samplePoints(const cv::Mat& image, Sampling sampling, const IntensityModel& intensity, const Points& points,
                 const Box& box, const PixelMap& map, Eigen::Ref<Eigen::ArrayXf> values,
                 Eigen::Ref<Eigen::ArrayXf> outside);

/// What samplePoints() with SPLINE finds at the pixels of an image. @param image CV_32FC1
cv::Mat splineFiltered(const cv::Mat& image);
}  // namespace xray_tracking
