#include <filesystem>
#include <fstream>

#include <yaml-cpp/yaml.h>

#include "../sequence/detector_node.h"
#include "import_words.h"
#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
void writeDetectors(const ImportedGeometry& geometry, const std::string& path, const std::string& into)
{
  namespace fs = std::filesystem;
  YAML::Node root;
  if (!into.empty())
  {
    try
    {
      root = YAML::LoadFile(into);
    }
    catch (const YAML::Exception& error)
    {
      fail(into, std::string("missing or not YAML: ") + error.what());
    }
    if (!root.IsMap())
    {
      fail(into, "expected keys with values");
    }
    const fs::path folder = fs::absolute(into).parent_path();
    if (folder != fs::absolute(path).parent_path())
    {
      for (const char* const key : { "ct", "frames", "gold_standard" })
      {
        if (root[key] && root[key].IsScalar())
        {
          root[key] = (folder / root[key].Scalar()).lexically_normal().string();
        }
      }
    }
  }
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
  std::ofstream file(path);
  file << root << "\n";
  file.close();
  if (!file)
  {
    fail(path, "cannot be written");
  }
}
}  // namespace xray_tracking
