#pragma once

#include <cstdint>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// A motion of all that an image shows, within the image.
struct PlanarMotion
{
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();  ///< of the region's centre [px]
  double rotation = 0.0;                                   ///< [rad]
  Eigen::Vector2d scale = Eigen::Vector2d::Ones();         ///< along columns and rows, after the rotation
};

/// How an exposure differs from the plain one; values in units of the region's contrast.
struct ExposureCondition
{
  double gain = 1.0;
  double offset = 0.0;
  double shading = 0.0;    ///< slow, at the region's corners
  bool occlusion = false;  ///< a plate over a quarter of the region, at a random place in every exposure
};

/// A region of 150 x 100 px of the projection of the neck phantom's spine (without soft tissue) under exact planar
/// motions: the detector, not the image, is moved the other way round, so that the exposures owe nothing to an
/// interpolation. Values are attenuation in 16 bit, the region's contrast (standard deviation) is 334 and the white
/// noise's 66.
class PlanarScene
{
public:
  /// @param setup_file of the neck phantom
  explicit PlanarScene(const std::string& setup_file);

  const cv::Rect& region() const { return region_; }
  Eigen::Vector2d regionCentre() const;

  /// @return CV_32FC1, without noise
  cv::Mat render(const PlanarMotion& motion) const;
  /// @param rendered by render(); @return CV_16UC1
  cv::Mat expose(const cv::Mat& rendered, const PlanarMotion& motion, const ExposureCondition& condition,
                 cv::RNG& random) const;

  /// The Cramer-Rao bound of the displacement of the region's centre [px], rms of both directions together, from all
  /// of the region's pixels with independent noise in the template's image and in the other. The other parameters of
  /// the model are estimated along with it.
  double displacementBound(MotionModel model) const;

private:
  NeckPhantom phantom_;
  RigidTransform room_from_patient_;
  DetectorDescription detector_;
  cv::Rect region_;
  double mean_ = 0.0;   ///< of the region's line integrals
  double scale_ = 1.0;  ///< values a unit of line integral
};
}  // namespace xray_tracking
