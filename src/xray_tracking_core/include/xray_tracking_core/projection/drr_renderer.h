#pragma once

#include <memory>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Digitally reconstructed radiographs: line integrals of a volume along the rays of a projection.
class DrrRenderer
{
public:
  virtual ~DrrRenderer() = default;

  /// Renders the whole panel.
  /// @param room_from_patient the volume's pose
  /// @param line_integrals out, CV_32FC1, rows x columns of the geometry: sum of value * length [value * mm], bright
  ///        where much is crossed; 0 where the ray misses the volume. Re-used if it has that size and type.
  /// @throws std::invalid_argument if the pose is not finite or not rigid
  virtual void render(const ProjectionGeometry& geometry, const RigidTransform& room_from_patient,
                      cv::Mat& line_integrals) const = 0;
};

/// Joseph's method (IEEE TMI 1(3), 1982): bilinear interpolation in the planes across the ray's main axis; on all
/// cores. The grid may be sheared or left-handed. The volume is shared, not copied, and must not change while the
/// renderer lives.
///
/// Outside the grid the value is 0. Along the main axis every voxel counts with its whole length, half a voxel beyond
/// the outermost centres; across it, values fall linearly from the outermost centres to 0 one voxel further out. The
/// ray starts at the focal spot (planes of voxel centres behind it do not count) and has no end, as projections do not
/// depend on the panel's distance.
/// @throws std::invalid_argument if the volume is missing, not of its grid's size, or its axes do not span space
std::unique_ptr<DrrRenderer> makeJosephRenderer(std::shared_ptr<const ScalarVolume> volume);
}  // namespace xray_tracking
