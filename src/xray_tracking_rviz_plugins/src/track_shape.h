#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <xray_tracking_msgs/RegionResiduals.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
/// Corners of a region, round its edge; pixel coordinates, edges of the outermost pixels.
using Outline = std::array<Eigen::Vector2d, 4>;

/// Where the region was in the exposure that it was learnt from; none if there is no region.
std::optional<Outline> outlineBegan(const xray_tracking_msgs::TrackedRegion& region);
/// Where it is now; none if that is not known, or not finite.
std::optional<Outline> outlineNow(const xray_tracking_msgs::TrackedRegion& region);
/// The middle of where it is now; none as above.
std::optional<Eigen::Vector2d> centreNow(const xray_tracking_msgs::TrackedRegion& region);

/// How much a place of the region differs from the template.
struct ResidualDot
{
  Eigen::Vector2d pixel;
  double share;  ///< of the template's standard deviation, without its sign, 0..1 and no more
};
/// None where the message's lists are not of one length; dots that are not finite are left out.
std::vector<ResidualDot> dotsOf(const xray_tracking_msgs::RegionResiduals& residuals);

/// In one or two words, for people.
std::string wordsOf(const xray_tracking_msgs::TrackedRegion& region);
enum class Mood
{
  GOOD,
  WARNING,
  BAD,
  QUIET
};
Mood moodOf(const xray_tracking_msgs::TrackedRegion& region);

using Segment = std::array<Eigen::Vector2d, 2>;
/// The twelve edges of a box as a detector sees it; those with an end behind the source are left out.
/// @param box patient frame [mm]
std::vector<Segment> projectedBox(const ProjectionGeometry& geometry, const RigidTransform& room_from_patient,
                                  const Eigen::AlignedBox3d& box);
}  // namespace xray_tracking
