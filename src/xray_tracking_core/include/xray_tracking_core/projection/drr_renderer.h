#pragma once

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"

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
}  // namespace xray_tracking
