#include "xray_tracking_core/projection/exact_projection.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace xray_tracking
{
namespace
{
/// A ray in voxel indices, parametrised by the path length [mm].
struct IndexRay
{
  Eigen::Vector3d source;
  Eigen::Vector3d direction;

  IndexRay(const VolumeGrid& grid, const Ray& ray)
  {
    const Eigen::Affine3d index_from_patient = grid.patient_from_index.inverse();
    source = index_from_patient * ray.source;
    direction = index_from_patient.linear() * ray.direction;
  }

  Eigen::Vector3d at(double length) const { return source + length * direction; }
};

/// Calls visit(from, to) [mm] for every part of the ray in front of its source between two crossings of the planes at
/// lowest, lowest + 1, ..., highest of the three axes [voxel].
template <typename Visit>
void forEachSegment(const IndexRay& ray, const Eigen::Vector3d& lowest, const Eigen::Vector3d& highest, Visit visit)
{
  double from = 0.0;
  double to = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis)
  {
    if (ray.direction[axis] == 0.0)
    {
      if (ray.source[axis] < lowest[axis] || ray.source[axis] > highest[axis])
      {
        return;
      }
      continue;
    }
    const double a = (lowest[axis] - ray.source[axis]) / ray.direction[axis];
    const double b = (highest[axis] - ray.source[axis]) / ray.direction[axis];
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  // Numbers, from `lowest` on, of the planes that are crossed next.
  Eigen::Vector3d next;
  const Eigen::Vector3d start = ray.at(from) - lowest;
  for (int axis = 0; axis < 3; ++axis)
  {
    next[axis] = ray.direction[axis] > 0.0 ? std::floor(start[axis]) + 1.0 : std::ceil(start[axis]) - 1.0;
  }
  while (from < to)
  {
    double end = to;
    int crossed = -1;
    for (int axis = 0; axis < 3; ++axis)
    {
      if (ray.direction[axis] == 0.0)
      {
        continue;
      }
      const double at = (lowest[axis] + next[axis] - ray.source[axis]) / ray.direction[axis];
      if (at < end)
      {
        end = at;
        crossed = axis;
      }
    }
    if (end > from)
    {
      visit(from, end);
      from = end;
    }
    if (crossed < 0)
    {
      return;
    }
    next[crossed] += ray.direction[crossed] > 0.0 ? 1.0 : -1.0;
  }
}

double trilinear(const ScalarVolume& volume, const Eigen::Vector3d& index)
{
  const Eigen::Array3d floor = index.array().floor();
  const Eigen::Vector3i low = floor.cast<int>();
  if ((low.array() >= 0).all() && (low.array() + 1 < volume.grid.size.array()).all())
  {
    // The same as below, without a look at each corner: nearly all of a volume.
    const Eigen::Array3d share = index.array() - floor;
    const std::size_t row = volume.grid.offset(0, 1, 0);
    const std::size_t slice = volume.grid.offset(0, 0, 1);
    const auto* corner = &volume.values[volume.grid.offset(low.x(), low.y(), low.z())];
    const auto along = [](double a, double b, double t) { return a + t * (b - a); };
    const auto edge = [&](std::size_t at) { return along(corner[at], corner[at + 1], share.x()); };
    const auto face = [&](std::size_t at) { return along(edge(at), edge(at + row), share.y()); };
    return along(face(0), face(slice), share.z());
  }
  double sum = 0.0;
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Vector3i voxel = low + Eigen::Vector3i(corner & 1, (corner >> 1) & 1, corner >> 2);
    if ((voxel.array() >= 0).all() && (voxel.array() < volume.grid.size.array()).all())
    {
      sum += (1.0 - (index - voxel.cast<double>()).array().abs()).prod() *
             volume.values[volume.grid.offset(voxel.x(), voxel.y(), voxel.z())];
    }
  }
  return sum;
}
}  // namespace

double integrateCuboids(const ScalarVolume& volume, const Ray& ray)
{
  const IndexRay index_ray(volume.grid, ray);
  const Eigen::Vector3d lowest = Eigen::Vector3d::Constant(-0.5);
  double sum = 0.0;
  forEachSegment(index_ray, lowest, lowest + volume.grid.size.cast<double>(),
                 [&](double from, double to)
                 {
                   const Eigen::Vector3i voxel = (index_ray.at(0.5 * (from + to)).array() + 0.5).floor().cast<int>();
                   const Eigen::Vector3i inside =
                       voxel.cwiseMax(0).cwiseMin(volume.grid.size - Eigen::Vector3i::Ones());
                   sum += (to - from) * volume.values[volume.grid.offset(inside.x(), inside.y(), inside.z())];
                 });
  return sum;
}

double integrateTrilinear(const ScalarVolume& volume, const Ray& ray)
{
  const IndexRay index_ray(volume.grid, ray);
  double sum = 0.0;
  forEachSegment(
      index_ray, Eigen::Vector3d::Constant(-1.0), volume.grid.size.cast<double>(),
      [&](double from, double to)
      {
        const double middle = 0.5 * (from + to);
        const double node = 0.5 * (to - from) / std::sqrt(3.0);
        sum += 0.5 * (to - from) *
               (trilinear(volume, index_ray.at(middle - node)) + trilinear(volume, index_ray.at(middle + node)));
      });
  return sum;
}
}  // namespace xray_tracking
