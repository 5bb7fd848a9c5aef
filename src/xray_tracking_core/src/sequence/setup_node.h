#pragma once

#include <string>

#include <yaml-cpp/yaml.h>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "yaml_field.h"

namespace xray_tracking
{
/// An entry of a setup's `detectors`.
YAML::Node detectorNode(const ProjectionGeometry& detector);

/// The list of detectors of a setup, or of the file that it names in their place.
/// @param path of the setup. @throws std::runtime_error as YamlField
YamlField detectorList(const YamlField& root, const std::string& path);

/// A setup or sequence.yaml as it is, for another file: the files that it names are found from there, too.
/// @throws std::runtime_error naming the file if it is missing, not YAML, or has no keys
YAML::Node setupNodeFor(const std::string& new_path, const std::string& path);

/// @throws std::runtime_error naming the file if it cannot be written
void writeSetupNode(const YAML::Node& root, const std::string& path);
}  // namespace xray_tracking
