#pragma once

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
/// A regular grid of points on a panel, at which line integrals are wanted.
struct PixelGrid
{
  Eigen::Vector2d first;  ///< pixel coordinates (u, v) of the grid's first point; whole numbers are pixel centres
  Eigen::Vector2d step;   ///< distance of neighbouring points along u and v [px], > 0
  Eigen::Vector2i size;   ///< points along u and v

  /// Every pixel of the panel.
  static PixelGrid wholePanel(const ProjectionGeometry& geometry)
  {
    return { Eigen::Vector2d::Zero(), Eigen::Vector2d::Ones(), geometry.imageSize() };
  }

  /// The centres of `binning` x `binning` pixel bins that tile the region from its first pixel on; incomplete bins at
  /// its far borders are left out.
  static PixelGrid binnedRegion(const Eigen::Vector2i& offset, const Eigen::Vector2i& size, int binning)
  {
    return { offset.cast<double>().array() + 0.5 * (binning - 1), Eigen::Vector2d::Constant(binning), size / binning };
  }
};
}  // namespace xray_tracking
