#include "shear_warp_view.h"

#include <cmath>

#include "shear_warp_kernel.h"

namespace xray_tracking
{
namespace shear_warp
{
namespace
{
/// Distance of the base plane's points in the farthest slice, where it is largest [voxel]: between the finest and the
/// coarsest, the distance of the points that are wanted. Rays along the slices' axis see the kinks of linear
/// interpolation, at the voxels, in line from slice to slice, and need a finer one than rays that blur them.
constexpr double kFinestPitch = 0.45;
constexpr double kFinestPitchInLine = 0.125;
/// From this slope on they are blurred [voxel / slice].
constexpr double kBlurringSlope = 0.25;
constexpr double kCoarsestPitch = 0.8;
static_assert(kCoarsestPitch < kMaxStep, "as accumulate() demands");

/// The kernel of cubic convolution (Keys, a = -1/2).
double cubic(double x)
{
  x = std::abs(x);
  return x < 1.0 ? (1.5 * x - 2.5) * x * x + 1.0 : x < 2.0 ? ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0 : 0.0;
}
}  // namespace

SlopeFilter::SlopeFilter(const Eigen::Vector2d& slope)
{
  const double node = std::sqrt(0.4);
  constexpr double kWeight = 1.0 / 4.8;
  constexpr double kNegligible = 0.05;
  if (slope.norm() < kNegligible)
  {
    return;
  }
  reach_ = (node * slope.cwiseAbs()).array().ceil().cast<int>() + kCubicReach - 1;
  for (int row = -reach_.y(); row <= reach_.y(); ++row)
  {
    for (int column = -reach_.x(); column <= reach_.x(); ++column)
    {
      const auto cubic_at = [&](double at) { return cubic(column - at * slope.x()) * cubic(row - at * slope.y()); };
      const double sum = kWeight * (cubic_at(-node) + cubic_at(node)) + (1.0 - 2.0 * kWeight) * cubic_at(0.0);
      if (sum != 0.0)
      {
        taps_.push_back({ { column, row }, static_cast<float>(sum) });
      }
    }
  }
}

BundleView::BundleView(const RayBundle& rays, const Eigen::Affine3d& all_index_from_room, const Eigen::Vector3i& order,
                       const Eigen::Vector3i& volume_size)
  : empty(true)
{
  Eigen::Vector3d size;
  for (int n = 0; n < 3; ++n)
  {
    index_from_room.row(n) = all_index_from_room.linear().row(order[n]);
    source[n] = index_from_room.row(n).dot(rays.source) + all_index_from_room.translation()[order[n]];
    size[n] = volume_size[order[n]];
  }
  const Eigen::Vector3d central_ray = rays.direction(0.5 * rays.last());
  const Eigen::Vector3d central = index_from_room * central_ray;
  depth = (central.z() > 0.0 ? size.z() - 1.0 : 0.0) - source.z();
  if (!(depth * central.z() > 0.0))
  {
    return;
  }
  constexpr double kNearest = 1e-3;
  first_slice = 0;
  last_slice = volume_size[order.z()] - 1;
  while (first_slice < last_slice && scale(first_slice) < kNearest)
  {
    ++first_slice;
  }
  while (last_slice > first_slice && scale(last_slice) < kNearest)
  {
    --last_slice;
  }

  const Eigen::Array2d by_u = onBase(central_ray + rays.by_u) - onBase(central_ray);
  const Eigen::Array2d by_v = onBase(central_ray + rays.by_v) - onBase(central_ray);
  const Eigen::Vector2d slope = central.head<2>() / central.z();
  const Eigen::Array2d blur = (slope.array().abs() / kBlurringSlope).min(1.0);
  const Eigen::Array2d finest = kFinestPitchInLine + blur * (kFinestPitch - kFinestPitchInLine);
  pitch = (by_u.square() + by_v.square()).sqrt().max(finest).min(kCoarsestPitch);
  filter = SlopeFilter((slope / scale((first_slice + last_slice) / 2)).cwiseQuotient(pitch));
  const Eigen::Vector2d margin = (filter.reach().array() + kCubicReach).cast<double>();

  // The part of the base plane that the rays need and that slices reach, which grows or shrinks with the slice.
  Eigen::AlignedBox2d wanted;
  rays.forCorners([&](const Eigen::Vector3d& ray) { wanted.extend(onBase(ray)); });
  Eigen::AlignedBox2d reached;
  // Values fall to zero over one voxel; the margin then holds zeros even after the filter.
  const Eigen::Vector2d beyond = Eigen::Vector2d::Ones() + margin.cwiseProduct(pitch);
  for (const int slice : { first_slice, last_slice })
  {
    const auto from_slice = [&](const Eigen::Vector2d& point) -> Eigen::Vector2d
    { return source.head<2>() + (point - source.head<2>()) / scale(slice); };
    reached.extend(from_slice(-beyond));
    reached.extend(from_slice(size.head<2>() + beyond));
  }
  const Eigen::AlignedBox2d box = wanted.intersection(reached);
  empty = box.isEmpty();
  if (!empty)
  {
    points = (box.sizes().cwiseQuotient(pitch) + 2.0 * margin).array().ceil().cast<int>() + 1;
    origin = box.min() - margin.cwiseProduct(pitch);
  }
}
}  // namespace shear_warp
}  // namespace xray_tracking
