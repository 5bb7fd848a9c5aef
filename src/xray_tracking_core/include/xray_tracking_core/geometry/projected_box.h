#pragma once

#include <Eigen/Geometry>
#include <opencv2/core/types.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// The pixels around a box's eight projected corners, clipped to the image; empty if none of it is seen, or a corner is
/// not in front of the source.
/// @param box patient frame [mm]
cv::Rect projectedBoxRegion(const Eigen::AlignedBox3d& box, const RigidTransform& room_from_patient,
                            const ProjectionGeometry& geometry);
}  // namespace xray_tracking
