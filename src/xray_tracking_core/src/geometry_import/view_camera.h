#pragma once

#include <Eigen/Core>

#include "imported_view.h"

namespace xray_tracking
{
/// A view's matrix taken apart. Left-handed if axes' determinant is -1.
struct Camera
{
  Eigen::Vector3d source;
  Eigen::Matrix3d axes;  ///< rows: along columns, along rows, from the source to the panel
  Eigen::Vector2d focal_length, foot;
  double skew = 0.0;  ///< px at the image's edge
};

/// Takes a view's matrix apart, whose sign is to be right.
Camera cameraOf(const ImportedView& view);

/// @throws std::runtime_error if the view's matrix is no camera's, or skewed too much
void checkMatrix(const ImportedView& view);
}  // namespace xray_tracking
