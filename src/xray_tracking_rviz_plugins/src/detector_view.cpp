#include "detector_view.h"

#include <algorithm>
#include <cmath>

namespace xray_tracking
{
bool sameProjection(const sensor_msgs::CameraInfo& a, const sensor_msgs::CameraInfo& b)
{
  return a.width == b.width && a.height == b.height && a.K == b.K && a.D == b.D && a.binning_x == b.binning_x &&
         a.binning_y == b.binning_y && a.roi == b.roi && a.header.frame_id == b.header.frame_id;
}

double panelDistance(const sensor_msgs::CameraInfo& info, const TreatmentSetup* setup, const std::string& detector,
                     double fallback)
{
  constexpr double kSame = 0.01;
  if (setup != nullptr)
  {
    for (const ProjectionGeometry& geometry : setup->detectors)
    {
      if (geometry.name() == detector && std::abs(geometry.focalLength().x() - info.K[0]) <= kSame * info.K[0])
      {
        return geometry.sourceToDetector();
      }
    }
  }
  return fallback;
}

std::optional<double> attenuationOf(double value, const IntensityModel& intensity, double largest)
{
  if (intensity.kind == IntensityModel::Kind::ATTENUATION)
  {
    return value;
  }
  const double air = intensity.air_counts.value_or(largest) - intensity.offset;
  if (!(air > 0.0))
  {
    return std::nullopt;
  }
  return std::log(air / std::max(value - intensity.offset, 1.0));
}

Eigen::Vector2d atIsocentre(const ProjectionGeometry& geometry, const Eigen::Vector2d& pixel)
{
  const Eigen::Vector3d isocentre = Eigen::Vector3d::Zero();
  return (pixel - geometry.project(isocentre)).cwiseQuotient(geometry.focalLength()) * geometry.depth(isocentre);
}
}  // namespace xray_tracking
