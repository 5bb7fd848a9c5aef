#pragma once

#include <yaml-cpp/yaml.h>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
/// An entry of a setup's `detectors`.
YAML::Node detectorNode(const ProjectionGeometry& detector);
}  // namespace xray_tracking
