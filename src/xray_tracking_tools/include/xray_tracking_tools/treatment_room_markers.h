#pragma once

#include <string>
#include <vector>

#include <geometry_msgs/TransformStamped.h>
#include <visualization_msgs/Marker.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_core/sequence/treatment_setup.h"

/// What RViz shows of a treatment room, in metres. Each kind of thing has a marker namespace of its own, so that it can
/// be switched: `sources`, `panels`, `panel_outlines`, `central_rays`, `beams`, `isocentre`, `target_box` (frame
/// patient), `region_rays`, `regions`, `trail`, `beam_gate`.
namespace xray_tracking
{
/// Static transforms: room to each detector's optical frame, patient to target (the target box's centre).
std::vector<geometry_msgs::TransformStamped> staticTransforms(const TreatmentSetup& setup);

/// Everything that does not depend on the exposures.
std::vector<visualization_msgs::Marker> staticMarkers(const TreatmentSetup& setup);

/// The line from the focal spot through the tracked region's centre to the panel, and the region's outline on the
/// panel; coloured by the region's state, at the template's place where there is no valid displacement. Markers that
/// delete them where the region is untrained.
std::vector<visualization_msgs::Marker> regionMarkers(const ProjectionGeometry& detector, int id,
                                                      const xray_tracking_msgs::TrackedRegion& region);

/// Takes markers' colour away: of what is not known to be so any more.
void fade(std::vector<visualization_msgs::Marker>& markers);

/// The way of the target's centre; deleted while it has fewer than two points.
visualization_msgs::Marker trailMarker(const std::vector<geometry_msgs::Point>& points);

/// Whether the beam is to be held, as text over the isocentre: green if not. @param why for people
visualization_msgs::Marker gateMarker(bool open, const std::string& why);
}  // namespace xray_tracking
