#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/projection/pixel_grid.h"

namespace xray_tracking
{
namespace shear_warp
{
/// The points (u, v) of a grid as rays: directions are at_zero + u * by_u + v * by_v, of the length to the panel [mm].
struct RayBundle
{
  Eigen::Vector3d source;
  Eigen::Vector3d at_zero;
  Eigen::Vector3d by_u;
  Eigen::Vector3d by_v;
  Eigen::Vector2i size;

  RayBundle(const ProjectionGeometry& geometry, const PixelGrid& pixels)
    : source(geometry.source()),
      at_zero(geometry.pixelPosition(pixels.first) - source),
      by_u(pixels.step.x() * geometry.pixelPitch().x() * geometry.xDirection()),
      by_v(pixels.step.y() * geometry.pixelPitch().y() * geometry.yDirection()),
      size(pixels.size)
  {
  }

  Eigen::Vector3d direction(const Eigen::Vector2d& point) const
  {
    return at_zero + point.x() * by_u + point.y() * by_v;
  }
  Eigen::Vector2d last() const { return (size - Eigen::Vector2i::Ones()).cast<double>(); }

  /// The part from `first` on with `count` points along the axis (0: u, 1: v).
  RayBundle part(int axis, int first, int count) const
  {
    RayBundle bundle = *this;
    bundle.at_zero += first * (axis == 0 ? by_u : by_v);
    bundle.size[axis] = count;
    return bundle;
  }

  /// Calls visit(ray) for the four outermost rays.
  template <typename Visit>
  void forCorners(Visit visit) const
  {
    for (const double u : { 0.0, last().x() })
    {
      for (const double v : { 0.0, last().y() })
      {
        visit(direction({ u, v }));
      }
    }
  }
};

/// The filter on the base plane that makes Joseph's sum over slices the integral of the trilinear volume.
///
/// Between two slices the trilinear volume fades from one to the other while the ray moves on by its slope. To the
/// integral every slice thus contributes its values along a line of twice the slope, weighted by a triangle. All rays
/// of a narrow bundle have about the same slope, so the same filter does for the whole base plane. The triangle's
/// integral is taken by three points that have its moments up to the fourth, each of them interpolated by cubic
/// convolution.
class SlopeFilter
{
public:
  struct Tap
  {
    Eigen::Vector2i at;
    float weight;
  };

  SlopeFilter() = default;
  /// @param slope of the central ray across the slices [base points / slice]
  explicit SlopeFilter(const Eigen::Vector2d& slope);

  const std::vector<Tap>& taps() const { return taps_; }  ///< empty if there is nothing to do
  const Eigen::Vector2i& reach() const { return reach_; }

private:
  Eigen::Vector2i reach_ = Eigen::Vector2i::Zero();
  std::vector<Tap> taps_;
};

/// How a narrow bundle of rays sees a stack of slices. Two-vectors are (column, row), three-vectors (column, row,
/// main).
struct BundleView
{
  Eigen::Matrix3d index_from_room;  ///< linear part
  Eigen::Vector3d source;           ///< [voxel]
  double depth;                     ///< of the base plane, the farthest slice, less the source's along main [voxel]
  int first_slice;                  ///< of those between source and base plane
  int last_slice;
  Eigen::Vector2d pitch;   ///< of the base plane's points [voxel]
  Eigen::Vector2d origin;  ///< place of the base plane's point (0, 0) [voxel]
  Eigen::Vector2i points;  ///< of the base plane, the margin included
  SlopeFilter filter;
  bool empty;  ///< no ray meets the slices; then the rest but index_from_room is not set

  /// @param order index axes as column, row, main; @param size of the volume
  BundleView(const RayBundle& rays, const Eigen::Affine3d& index_from_room, const Eigen::Vector3i& order,
             const Eigen::Vector3i& size);

  /// Distance of a slice from the source in units of the base plane's.
  double scale(int slice) const { return (slice - source.z()) / depth; }
  /// Where a ray meets the base plane [voxel].
  Eigen::Vector2d onBase(const Eigen::Vector3d& ray) const
  {
    const Eigen::Vector3d direction = index_from_room * ray;
    return source.head<2>() + direction.head<2>() * (depth / direction.z());
  }
};

/// Points around a position on the base plane that cubic convolution reaches.
constexpr int kCubicReach = 2;
}  // namespace shear_warp
}  // namespace xray_tracking
