#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// What an image intensifier or a lens does to an image, in the terms of OpenCV and sensor_msgs/CameraInfo's D: where a
/// point at (x, y) = ((u - cx) / fx, (v - cy) / fy) of the projection is found in the image. Copies share their maps.
class LensDistortion
{
public:
  LensDistortion() = default;  ///< none
  /// @param model plumb_bob, with k1, k2, p1, p2 and perhaps k3, or rational_polynomial, with k1, k2, p1, p2, k3 to k6;
  ///        all zero: none
  /// @param detector the projection without the distortion, for which it must be of use: it folds no part of the image
  ///        over another and moves no pixel by more than a quarter of the image
  /// @throws std::invalid_argument naming the model, the coefficient or the pixel, its value and what was expected
  LensDistortion(const std::string& model, const std::vector<double>& coefficients, const ProjectionGeometry& detector);

  bool none() const { return map_x_.empty(); }

  /// The image that the detector's projection describes, linearly interpolated. Pixels that the distorted image does
  /// not have are as dark as can be: they are taken for the field's border.
  /// @param image one channel of 8 or 16 bit, of the detector's size; without a distortion it is returned itself
  cv::Mat undo(const cv::Mat& image, IntensityModel::Kind kind) const;

private:
  cv::Mat map_x_;  ///< CV_32FC1: where pixels of the projection are found
  cv::Mat map_y_;
};
}  // namespace xray_tracking
