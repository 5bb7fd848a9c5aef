#include "track_shape.h"

#include <algorithm>
#include <cmath>

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::TrackedRegion;

constexpr double kSigns[4][2] = { { -1.0, -1.0 }, { 1.0, -1.0 }, { 1.0, 1.0 }, { -1.0, 1.0 } };

Eigen::Vector2d sizeOf(const TrackedRegion& region)
{
  return { static_cast<double>(region.region.width), static_cast<double>(region.region.height) };
}

Eigen::Vector2d centreBegan(const TrackedRegion& region)
{
  return Eigen::Vector2d(region.region.x_offset, region.region.y_offset) +
         0.5 * (sizeOf(region) - Eigen::Vector2d::Ones());
}
}  // namespace

std::optional<Outline> outlineBegan(const TrackedRegion& region)
{
  if (region.region.width == 0 || region.region.height == 0)
  {
    return std::nullopt;
  }
  Outline corners;
  for (std::size_t i = 0; i < corners.size(); ++i)
  {
    corners[i] = centreBegan(region) + 0.5 * sizeOf(region).cwiseProduct(Eigen::Vector2d(kSigns[i][0], kSigns[i][1]));
  }
  return corners;
}

std::optional<Eigen::Vector2d> centreNow(const TrackedRegion& region)
{
  const Eigen::Vector2d displacement(region.displacement_x, region.displacement_y);
  const bool known = region.state == TrackedRegion::TRACKING || region.state == TrackedRegion::DEGRADED;
  if (!known || !displacement.allFinite() || region.region.width == 0 || region.region.height == 0)
  {
    return std::nullopt;
  }
  return centreBegan(region) + displacement;
}

std::optional<Outline> outlineNow(const TrackedRegion& region)
{
  const std::optional<Eigen::Vector2d> centre = centreNow(region);
  const Eigen::Matrix2d linear = Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(region.linear.data());
  if (!centre || !linear.allFinite())
  {
    return std::nullopt;
  }
  Outline corners;
  for (std::size_t i = 0; i < corners.size(); ++i)
  {
    corners[i] = *centre + linear * (0.5 * sizeOf(region).cwiseProduct(Eigen::Vector2d(kSigns[i][0], kSigns[i][1])));
  }
  return corners;
}

std::vector<ResidualDot> dotsOf(const xray_tracking_msgs::RegionResiduals& residuals)
{
  std::vector<ResidualDot> dots;
  if (residuals.u.size() != residuals.v.size() || residuals.u.size() != residuals.residual.size())
  {
    return dots;
  }
  for (std::size_t i = 0; i < residuals.u.size(); ++i)
  {
    const ResidualDot dot{ { residuals.u[i], residuals.v[i] }, std::min(1.0, std::abs(double(residuals.residual[i]))) };
    if (dot.pixel.allFinite() && std::isfinite(residuals.residual[i]))
    {
      dots.push_back(dot);
    }
  }
  return dots;
}

std::string wordsOf(const TrackedRegion& region)
{
  switch (region.state)
  {
    case TrackedRegion::UNTRAINED:
      return "no region";
    case TrackedRegion::TRAINING:
      return "learning";
    case TrackedRegion::TRACKING:
      return "tracking";
    case TrackedRegion::LOST:
      return "lost";
    case TrackedRegion::DEGRADED:
      return "doubtful";
    case TrackedRegion::BLIND:
      return "blind";
    default:
      return "unknown state " + std::to_string(region.state);
  }
}

Mood moodOf(const TrackedRegion& region)
{
  switch (region.state)
  {
    case TrackedRegion::TRACKING:
      return Mood::GOOD;
    case TrackedRegion::DEGRADED:
    case TrackedRegion::TRAINING:
      return Mood::WARNING;
    case TrackedRegion::UNTRAINED:
      return Mood::QUIET;
    default:
      return Mood::BAD;
  }
}

std::vector<Segment> projectedBox(const ProjectionGeometry& geometry, const RigidTransform& room_from_patient,
                                  const Eigen::AlignedBox3d& box)
{
  using Corner = Eigen::AlignedBox3d::CornerType;
  std::vector<Segment> segments;
  for (int corner = 0; corner < 8; ++corner)
  {
    for (const int bit : { 1, 2, 4 })  // corners whose numbers differ in one bit share an edge
    {
      if ((corner & bit) == 0)
      {
        const Segment segment{ geometry.project(room_from_patient * box.corner(static_cast<Corner>(corner))),
                               geometry.project(room_from_patient * box.corner(static_cast<Corner>(corner | bit))) };
        if (segment[0].allFinite() && segment[1].allFinite())
        {
          segments.push_back(segment);
        }
      }
    }
  }
  return segments;
}
}  // namespace xray_tracking
