#include "xray_tracking_core/plan/structure.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "rt_file.h"
#include "structure_set.h"

namespace xray_tracking
{
namespace
{
/// Beyond all places [mm].
constexpr double kFar = 1e5;
/// What rounding to 0.1 mm makes of a plane that is oblique, twice [mm].
constexpr double kPlanar = 0.2;
/// Planning systems draw on every slice, or on every second or third of thin ones [mm].
constexpr double kMostApart = 10.0;
/// Of the usual distance: beyond it a plane has no neighbour there.
constexpr double kNeighbour = 1.5;
/// Of the usual distance: contours of one plane.
constexpr double kOnePlane = 0.3;
/// Contours nearer to each other all along are one, drawn twice; what overlaps by less is rounding [mm].
constexpr double kSame = 0.5;
/// Of places along the normal [mm].
constexpr double kRounding = 1e-3;

/// Twice the area as a vector along the normal; its sign is that of the order of points.
Eigen::Vector3d areaVector(const std::vector<Eigen::Vector3d>& points)
{
  Eigen::Vector3d area = Eigen::Vector3d::Zero();
  for (std::size_t n = 1; n + 1 < points.size(); ++n)
  {
    area += (points[n] - points[0]).cross(points[n + 1] - points[0]);
  }
  return area;
}

using Polygon = std::vector<cv::Point2f>;

/// The least and the largest distance that points lie inside of a polygon; negative: outside.
std::pair<double, double> depths(const Polygon& points, const Polygon& polygon)
{
  std::pair<double, double> range(kFar, -kFar);
  for (const cv::Point2f& point : points)
  {
    const double depth = cv::pointPolygonTest(polygon, point, true);
    range = { std::min(range.first, depth), std::max(range.second, depth) };
  }
  return range;
}
}  // namespace

void Structure::fail(const std::string& what) const
{
  failRt(choice_.file, "ROI '" + choice_.roi + "': " + what);
}

Structure Structure::read(const StructureChoice& choice)
{
  const DrawnStructure drawn = readDrawnStructure(choice);
  Structure structure;
  structure.choice_ = choice;
  structure.uid_ = drawn.uid;
  structure.frame_of_reference_ = drawn.frame_of_reference;
  structure.patient_id_ = drawn.patient_id;
  structure.setAxes(drawn.contours);
  structure.setPlanes(drawn.contours, drawn.slab_thickness);
  return structure;
}

void Structure::setAxes(const std::vector<DrawnContour>& contours)
{
  // Of all contours: that of a small one is mostly rounding.
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const DrawnContour& contour : contours)
  {
    const Eigen::Vector3d area = areaVector(contour.points);
    sum += area.dot(sum) < 0.0 ? Eigen::Vector3d(-area) : area;
  }
  if (!(sum.norm() > 1e-3))
  {
    fail("its contours enclose nothing, expected an area");
  }
  const Eigen::Vector3d normal = sum.normalized();
  plane_from_patient_.row(0) = normal.unitOrthogonal();
  plane_from_patient_.row(1) = normal.cross(normal.unitOrthogonal());
  plane_from_patient_.row(2) = normal;
}

void Structure::setPlanes(const std::vector<DrawnContour>& contours, double slab_thickness)
{
  std::vector<std::pair<double, std::vector<Eigen::Vector2d>>> by_offset;
  for (const DrawnContour& contour : contours)
  {
    double least = kFar, most = -kFar, mean = 0.0;
    std::vector<Eigen::Vector2d> flat;
    for (const Eigen::Vector3d& point : contour.points)
    {
      const Eigen::Vector3d turned = plane_from_patient_ * point;
      flat.emplace_back(turned.head<2>());
      least = std::min(least, turned.z());
      most = std::max(most, turned.z());
      mean += turned.z() / static_cast<double>(contour.points.size());
    }
    if (most - least > 2.0 * kPlanar)
    {
      std::ostringstream message;
      message << "contour " << contour.number << " is " << most - least << " mm thick along the normal "
              << plane_from_patient_.row(2) << " of the others, expected plane contours on parallel planes, "
              << 2.0 * kPlanar << " mm at most";
      fail(message.str());
    }
    by_offset.emplace_back(mean, std::move(flat));
  }
  std::stable_sort(by_offset.begin(), by_offset.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  double widest = 0.0;
  for (auto& [offset, contour] : by_offset)
  {
    if (planes_.empty() || offset - planes_.back().offset > kPlanar)
    {
      planes_.push_back({ offset, offset, offset, {} });
    }
    widest = std::max(widest, offset - planes_.back().offset);
    planes_.back().contours.push_back(std::move(contour));
  }

  double usual = slab_thickness;
  std::vector<double> distances;
  for (std::size_t n = 1; n < planes_.size(); ++n)
  {
    distances.push_back(planes_[n].offset - planes_[n - 1].offset);
  }
  if (!distances.empty())
  {
    std::vector<double> sorted = distances;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    usual = *middle;
  }
  std::ostringstream message;
  if (!(usual > 0.0))
  {
    message << "all contours are on one plane and ContourSlabThickness (3006,0044) is absent, expected contours on at "
               "least two slices: how far does it reach beside the plane?";
  }
  else if (usual > kMostApart)
  {
    message << "its contours are " << usual << " mm apart, expected at most " << kMostApart
            << ": let the planning system draw those in between";
  }
  else if (widest > kOnePlane * usual)
  {
    message << "contours " << widest << " mm apart may be on one plane or on two, as planes are " << usual
            << " mm apart, expected planes at least " << kPlanar / kOnePlane << " mm apart";
  }
  if (!message.str().empty())
  {
    fail(message.str());
  }
  for (std::size_t n = 0; n < planes_.size(); ++n)
  {
    const auto reach = [&](bool exists, std::size_t gap)
    { return 0.5 * (exists && distances[gap] <= kNeighbour * usual ? distances[gap] : usual); };
    planes_[n].lower = planes_[n].offset - reach(n > 0, n - 1);
    planes_[n].upper = planes_[n].offset + reach(n + 1 < planes_.size(), n);
    requireApart(planes_[n]);
  }
}

void Structure::requireApart(const Plane& plane) const
{
  std::vector<Polygon> polygons;
  std::vector<Eigen::AlignedBox2d> boxes;
  for (const std::vector<Eigen::Vector2d>& contour : plane.contours)
  {
    polygons.emplace_back();
    boxes.emplace_back();
    for (const Eigen::Vector2d& point : contour)
    {
      polygons.back().emplace_back(static_cast<float>(point.x()), static_cast<float>(point.y()));
      boxes.back().extend(point);
    }
  }
  for (std::size_t a = 0; a < polygons.size(); ++a)
  {
    for (std::size_t b = 0; b < a; ++b)
    {
      if (!boxes[a].intersects(boxes[b]))
      {
        continue;
      }
      const auto [a_least, a_most] = depths(polygons[a], polygons[b]);
      const auto [b_least, b_most] = depths(polygons[b], polygons[a]);
      const bool same = std::max({ -a_least, a_most, -b_least, b_most }) < kSame;
      const bool partly = (a_least < -kSame && a_most > kSame) || (b_least < -kSame && b_most > kSame);
      if (same || partly)
      {
        const Eigen::Vector3d point =
            plane_from_patient_.transpose() *
            Eigen::Vector3d(plane.contours[a].front().x(), plane.contours[a].front().y(), plane.offset);
        fail(std::string(same ? "a contour is there twice" : "two contours overlap in part") +
             " on the plane through " + numbersText({ point.x(), point.y(), point.z() }) +
             " mm, expected contours beside or within each other: is it a hole or is it inside?");
      }
    }
  }
}

Eigen::AlignedBox3d Structure::box() const
{
  Eigen::AlignedBox3d box;
  for (const Plane& plane : planes_)
  {
    for (const std::vector<Eigen::Vector2d>& contour : plane.contours)
    {
      for (const Eigen::Vector2d& point : contour)
      {
        for (const double offset : { plane.lower, plane.upper })
        {
          box.extend(plane_from_patient_.transpose() * Eigen::Vector3d(point.x(), point.y(), offset));
        }
      }
    }
  }
  return box;
}

void Structure::inside(const Eigen::Vector3d& start, const Eigen::Vector3d& step, int count,
                       std::vector<std::pair<int, int>>& runs) const
{
  const Eigen::Vector3d first = plane_from_patient_ * start;
  const Eigen::Vector3d along = plane_from_patient_ * step;
  const auto indexFrom = [&](double place)
  { return static_cast<int>(std::clamp(std::ceil(place), 0.0, double(count))); };
  std::vector<double> crossings;
  for (const Plane& plane : planes_)
  {
    // The row's part within the slab. Where contours are on every second slice a slab ends at voxels' centres: they
    // belong to the one above, whatever is rounded.
    const double lower = plane.lower - kRounding, upper = plane.upper - kRounding;
    int begin = 0, end = count;
    if (std::abs(along.z()) * count > 1e-9)
    {
      const double a = (lower - first.z()) / along.z(), b = (upper - first.z()) / along.z();
      begin = indexFrom(std::min(a, b));
      end = indexFrom(std::max(a, b));
    }
    else if (first.z() < lower || first.z() >= upper)
    {
      continue;
    }
    if (begin >= end)
    {
      continue;
    }
    crossings.clear();
    const auto side = [&](const Eigen::Vector2d& point)
    { return along.x() * (point.y() - first.y()) - along.y() * (point.x() - first.x()); };
    for (const std::vector<Eigen::Vector2d>& contour : plane.contours)
    {
      const Eigen::Vector2d* before = &contour.back();
      double side_before = side(*before);
      for (const Eigen::Vector2d& point : contour)
      {
        const double side_here = side(point);
        if ((side_before > 0.0) != (side_here > 0.0))
        {
          const Eigen::Vector2d cross = *before + side_before / (side_before - side_here) * (point - *before);
          crossings.push_back((cross - first.head<2>()).dot(along.head<2>()) / along.head<2>().squaredNorm());
        }
        before = &point;
        side_before = side_here;
      }
    }
    std::sort(crossings.begin(), crossings.end());
    for (std::size_t n = 0; n + 1 < crossings.size(); n += 2)
    {
      const int from = std::max(begin, indexFrom(crossings[n])), to = std::min(end, indexFrom(crossings[n + 1]));
      if (from < to)
      {
        runs.emplace_back(from, to);
      }
    }
  }
}

CtVolume Structure::labels(const VolumeGrid& grid) const
{
  CtVolume volume{ grid, std::vector<std::int16_t>(grid.voxelCount(), 0) };
  // Rows along the axis that lies best in the planes.
  const Eigen::Matrix3d axes = plane_from_patient_ * grid.patient_from_index.linear();
  Eigen::Index row = 0;
  axes.topRows<2>().colwise().norm().cwiseQuotient(axes.colwise().norm()).maxCoeff(&row);
  const auto u = static_cast<int>((row + 1) % 3), v = static_cast<int>((row + 2) % 3);
  std::vector<std::pair<int, int>> runs;
  bool any = false;
  for (int n = 0; n < grid.size[v]; ++n)
  {
    for (int m = 0; m < grid.size[u]; ++m)
    {
      Eigen::Vector3i index = Eigen::Vector3i::Zero();
      index[u] = m;
      index[v] = n;
      runs.clear();
      inside(grid.patient_from_index * index.cast<double>(), grid.patient_from_index.linear().col(row), grid.size[row],
             runs);
      for (const auto& [from, to] : runs)
      {
        any = true;
        for (index[row] = from; index[row] < to; ++index[row])
        {
          volume.hu[grid.offset(index.x(), index.y(), index.z())] = 1;
        }
      }
    }
  }
  if (!any)
  {
    fail("no voxel of the CT is inside, expected a structure that was drawn on it");
  }
  return volume;
}

void Structure::requireOn(const CtFrame& ct) const
{
  if (ct.frame_of_reference != frame_of_reference_)
  {
    fail("its frame of reference (3006,0024) is " + frame_of_reference_ + ", that of the CT " + ct.path +
         " (0020,0052) " + ct.frame_of_reference + ": expected the same; it was drawn on another scan");
  }
  // Contours reach half way to the planes beside theirs.
  Eigen::AlignedBox3d reach = ct.grid.extent();
  const Eigen::Vector3d margin = Eigen::Vector3d::Constant(ct.grid.spacing().maxCoeff());
  reach = Eigen::AlignedBox3d(reach.min() - margin, reach.max() + margin);
  if (!reach.contains(box()))
  {
    std::ostringstream message;
    message << "it reaches from " << box().min().transpose() << " to " << box().max().transpose() << " mm, the CT "
            << ct.path << " from " << ct.grid.extent().min().transpose() << " to " << ct.grid.extent().max().transpose()
            << ": expected a structure within it";
    fail(message.str());
  }
}
}  // namespace xray_tracking
