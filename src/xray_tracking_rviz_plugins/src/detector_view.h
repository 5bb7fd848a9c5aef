#pragma once

#include <optional>
#include <string>

#include <sensor_msgs/CameraInfo.h>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Whether both describe the same projection.
bool sameProjection(const sensor_msgs::CameraInfo& a, const sensor_msgs::CameraInfo& b);

/// How far from the source a detector's panel stands [mm], which its camera_info leaves open: as in the setup, if its
/// detector of this name has that projection, or else the fallback. @param setup may be null
double panelDistance(const sensor_msgs::CameraInfo& info, const TreatmentSetup* setup, const std::string& detector,
                     double fallback);

/// What a pixel value says of the line integral to it, as the registration takes it; none if the values do not allow
/// it. @param largest of the image's values, which stands for air where that is not known
std::optional<double> attenuationOf(double value, const IntensityModel& intensity, double largest);

/// Where a pixel's ray passes the isocentre's distance from the source, as seen from the isocentre: along columns and
/// along rows [mm].
Eigen::Vector2d atIsocentre(const ProjectionGeometry& geometry, const Eigen::Vector2d& pixel);
}  // namespace xray_tracking
