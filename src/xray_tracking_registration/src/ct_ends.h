#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/projection/pixel_grid.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Where a CT ends though the body goes on: rays that leave through such an end lack what lies beyond, so that its
/// border stands out in a rendering and in no X-ray image.
class CtEnds
{
public:
  /// None.
  CtEnds() = default;
  /// @param volume attenuation [1/mm]
  explicit CtEnds(const ScalarVolume& volume);

  /// Whether a ray crosses an end inside the body. Ends that a ray meets head-on do not count: what lies beyond them
  /// changes too little from ray to ray to be seen.
  /// @param ray in the volume's patient frame
  bool cut(const Ray& ray) const;

private:
  struct Face
  {
    int axis;      ///< across it
    double plane;  ///< [voxel]
    cv::Mat body;  ///< CV_8UC1, not 0 where the body goes on; columns and rows are the next axes
  };

  Eigen::Affine3d index_from_patient_ = Eigen::Affine3d::Identity();
  std::vector<Face> faces_;
};

/// A volume's ends where it is.
struct PlacedEnds
{
  const CtEnds& ends;
  RigidTransform room_from_ct;
};

/// 1 where a grid's rays cross none of the ends, else 0: CV_32FC1 of the grid's size.
cv::Mat insideEnds(const ProjectionGeometry& geometry, const PixelGrid& pixels, const std::vector<PlacedEnds>& ends);
}  // namespace xray_tracking
