#include <yaml-cpp/yaml.h>

#include "../sequence/setup_node.h"
#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
void writeDetectors(const ImportedGeometry& geometry, const std::string& path, const std::string& into)
{
  YAML::Node root = into.empty() ? YAML::Node() : setupNodeFor(path, into);
  YAML::Node list;
  for (std::size_t n = 0; n < geometry.detectors.size(); ++n)
  {
    YAML::Node detector = detectorNode(geometry.detectors[n]);
    if (!geometry.distortions[n].model.empty())
    {
      detector["distortion"]["model"] = geometry.distortions[n].model;
      detector["distortion"]["coefficients"] = geometry.distortions[n].values;
      detector["distortion"].SetStyle(YAML::EmitterStyle::Flow);
    }
    list.push_back(detector);
  }
  root["detectors"] = list;
  writeSetupNode(root, path);
}
}  // namespace xray_tracking
