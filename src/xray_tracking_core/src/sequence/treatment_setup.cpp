#include "xray_tracking_core/sequence/treatment_setup.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "../volume/short_uids.h"
#include "setup_node.h"
#include "xray_tracking_core/geometry/projected_box.h"
#include "xray_tracking_core/plan/structure.h"
#include "yaml_field.h"

namespace xray_tracking
{
namespace
{
const Eigen::IOFormat kListFormat(Eigen::StreamPrecision, Eigen::DontAlignCols, ", ");

std::string resolvePath(const std::string& path, const std::string& file)
{
  return (std::filesystem::absolute(file).parent_path() / path).lexically_normal().string();
}

ProjectionGeometry readDetector(const YamlField& field)
{
  field.refuseMisspelt(
      { "name", "image_size", "pixel_pitch_mm", "source_mm", "origin_mm", "x_direction", "y_direction", "distortion" });
  DetectorDescription description;
  description.name = field.get("name").text();
  description.image_size = field.get("image_size").vector<int, 2>();
  description.pixel_pitch = field.get("pixel_pitch_mm").vector<double, 2>();
  description.source = field.get("source_mm").vector<double, 3>();
  description.origin = field.get("origin_mm").vector<double, 3>();
  description.x_direction = field.get("x_direction").vector<double, 3>();
  description.y_direction = field.get("y_direction").vector<double, 3>();
  try
  {
    return ProjectionGeometry::fromDescription(description);
  }
  catch (const std::invalid_argument& error)
  {
    throw std::runtime_error(field.where() + ": " + error.what());
  }
}

std::vector<ProjectionGeometry> readDetectors(const YamlField& list)
{
  std::vector<ProjectionGeometry> detectors;
  list.forEachItem(
      [&](const YamlField& item)
      {
        ProjectionGeometry detector = readDetector(item);
        for (const ProjectionGeometry& other : detectors)
        {
          if (other.name() == detector.name())
          {
            item.get("name").fail("a name that no other detector has");
          }
        }
        detectors.push_back(std::move(detector));
      });
  if (detectors.size() < 2)
  {
    list.fail("two or more detectors");
  }
  return detectors;
}

IntensityModel readIntensity(const YamlField& field)
{
  field.refuseMisspelt({ "kind", "offset", "air_counts" });
  IntensityModel intensity;
  if (const auto kind = field.find("kind"))
  {
    if (kind->text() != "counts" && kind->text() != "attenuation")
    {
      kind->fail("counts or attenuation");
    }
    intensity.kind = kind->text() == "counts" ? IntensityModel::Kind::COUNTS : IntensityModel::Kind::ATTENUATION;
  }
  if (const auto offset = field.find("offset"))
  {
    intensity.offset = offset->number<double>();
  }
  if (const auto air_counts = field.find("air_counts"))
  {
    intensity.air_counts = air_counts->number<double>();
    if (*intensity.air_counts <= intensity.offset)
    {
      air_counts->fail("a number above offset");
    }
  }
  return intensity;
}

RigidTransform readPose(const YamlField& field)
{
  const Eigen::Vector3d translation = field.get("translation_mm").vector<double, 3>();
  const Eigen::Vector4d rotation = field.get("rotation_xyzw").vector<double, 4>();
  try
  {
    return makeRigidTransform(translation, Eigen::Quaterniond(rotation[3], rotation[0], rotation[1], rotation[2]));
  }
  catch (const std::invalid_argument& error)
  {
    throw std::runtime_error(field.where() + ": " + error.what());
  }
}

Eigen::AlignedBox3d readBox(const YamlField& field)
{
  const Eigen::Vector3d min = field.get("min").vector<double, 3>();
  const Eigen::Vector3d max = field.get("max").vector<double, 3>();
  if (!(min.array() < max.array()).all())
  {
    field.fail("every component of min below that of max");
  }
  return { min, max };
}

/// The box of the structure that `target` names, which must have been drawn on the CT.
Eigen::AlignedBox3d readTarget(const YamlField& field, const std::string& path, TreatmentSetup& setup)
{
  setup.target_structure = { resolvePath(field.get("rtstruct").text(), path), field.get("roi").text() };
  if (setup.ct_path.empty())
  {
    field.fail("ct as well: the DICOM series that the structure was drawn on");
  }
  try
  {
    const Structure structure = Structure::read(*setup.target_structure);
    structure.requireOn(readCtFrame(setup.ct_path, setup.ct_choice.series));
    return structure.box();
  }
  catch (const std::runtime_error& error)
  {
    throw std::runtime_error(field.where() + ": " + error.what());
  }
}

cv::Rect readRegion(const YamlField& field, const Eigen::Vector2i& image_size)
{
  const cv::Rect region(field.get("x_offset").number<int>(), field.get("y_offset").number<int>(),
                        field.get("width").number<int>(), field.get("height").number<int>());
  // Compared by subtraction: a sum may overflow.
  if (region.x < 0 || region.y < 0 || region.width < 1 || region.height < 1 ||
      region.x > image_size.x() - region.width || region.y > image_size.y() - region.height)
  {
    field.fail("a region inside the image of " + std::to_string(image_size.x()) + " x " +
               std::to_string(image_size.y()));
  }
  return region;
}

template <typename Vector>
std::vector<typename Vector::Scalar> listOf(const Vector& vector)
{
  return { vector.data(), vector.data() + vector.size() };
}

YAML::Node nodeOf(const Eigen::AlignedBox3d& box)
{
  YAML::Node node;
  node["min"] = listOf(box.min());
  node["max"] = listOf(box.max());
  return node;
}

YAML::Node nodeOf(const RigidTransform& pose)
{
  YAML::Node node;
  const Eigen::Quaterniond rotation(pose.linear());
  node["translation_mm"] = listOf(Eigen::Vector3d(pose.translation()));
  node["rotation_xyzw"] = listOf(rotation.coeffs());
  return node;
}

YAML::Node nodeOf(const cv::Rect& region)
{
  YAML::Node node;
  node["x_offset"] = region.x;
  node["y_offset"] = region.y;
  node["width"] = region.width;
  node["height"] = region.height;
  return node;
}
}  // namespace

YAML::Node detectorNode(const ProjectionGeometry& detector)
{
  YAML::Node node;
  node["name"] = detector.name();
  node["image_size"] = listOf(detector.imageSize());
  node["pixel_pitch_mm"] = listOf(detector.pixelPitch());
  node["source_mm"] = listOf(detector.source());
  node["origin_mm"] = listOf(detector.origin());
  node["x_direction"] = listOf(detector.xDirection());
  node["y_direction"] = listOf(detector.yDirection());
  for (const auto& key : node)
  {
    YAML::Node value = key.second;
    value.SetStyle(YAML::EmitterStyle::Flow);
  }
  return node;
}

const ProjectionGeometry& TreatmentSetup::detector(const std::string& name) const
{
  std::string known;
  for (const ProjectionGeometry& geometry : detectors)
  {
    if (geometry.name() == name)
    {
      return geometry;
    }
    known += (known.empty() ? "" : ", ") + geometry.name();
  }
  throw std::invalid_argument("detector '" + name + "' is unknown: expected one of " + known);
}

YamlField detectorList(const YamlField& root, const std::string& path)
{
  const YamlField list = root.get("detectors");
  return list.isScalar() ? YamlField::fromFile(resolvePath(list.text(), path)).get("detectors") : list;
}

std::vector<ProjectionGeometry> loadDetectors(const std::string& path)
{
  return readDetectors(detectorList(YamlField::fromFile(path), path));
}

namespace
{
/// @param path of the file, where relative paths start
TreatmentSetup readTreatmentSetup(const YamlField& root, const std::string& path)
{
  root.refuseMisspelt({ "ct", "ct_content", "ct_series", "ct_nifti_form", "intensity", "detectors", "initial_pose",
                        "target_box_mm", "target", "regions", "frames", "gold_standard", "pairing_tolerance" });
  TreatmentSetup setup;
  if (const auto ct = root.find("ct"))
  {
    setup.ct_path = resolvePath(ct->text(), path);
  }
  if (const auto content = root.find("ct_content"))
  {
    try
    {
      setup.ct_content = ctContentNamed(content->text());
    }
    catch (const std::invalid_argument&)
    {
      content->fail("recognised, full, bone_in_air or labels");
    }
  }
  if (const auto series = root.find("ct_series"))
  {
    setup.ct_choice.series = series->text();
  }
  if (const auto form = root.find("ct_nifti_form"))
  {
    if (form->text() != "qform" && form->text() != "sform")
    {
      form->fail("qform or sform");
    }
    setup.ct_choice.nifti_form = form->text() == "qform" ? NiftiForm::QFORM : NiftiForm::SFORM;
  }
  if (const auto intensity = root.find("intensity"))
  {
    setup.intensity = readIntensity(*intensity);
  }
  setup.detectors = readDetectors(detectorList(root, path));
  setup.room_from_patient = readPose(root.get("initial_pose"));
  const auto target = root.find("target");
  setup.target_box = target ? readTarget(*target, path, setup) : readBox(root.get("target_box_mm"));
  if (const auto box = root.find("target_box_mm"); box && target)
  {
    // Files are written with a few digits.
    constexpr double kSameBox = 0.01;  // [mm]
    const Eigen::AlignedBox3d other = readBox(*box);
    if ((other.min() - setup.target_box.min()).cwiseAbs().maxCoeff() > kSameBox ||
        (other.max() - setup.target_box.max()).cwiseAbs().maxCoeff() > kSameBox)
    {
      std::ostringstream message;
      message << "target (" << setup.target_structure->roi
              << ") or target_box_mm alone, or both the same: target's is min ["
              << setup.target_box.min().transpose().format(kListFormat) << "], max ["
              << setup.target_box.max().transpose().format(kListFormat) << "]";
      box->fail(message.str());
    }
  }
  if (const auto regions = root.find("regions"))
  {
    regions->forEachEntry(
        [&](const std::string& name, const YamlField& region)
        {
          try
          {
            setup.regions[name] = readRegion(region, setup.detector(name).imageSize());
          }
          catch (const std::invalid_argument& error)
          {
            throw std::runtime_error(region.where() + ": " + error.what());
          }
        });
  }
  return setup;
}

}  // namespace

TreatmentSetup loadTreatmentSetup(const std::string& path)
{
  return readTreatmentSetup(YamlField::fromFile(path), path);
}

TreatmentSetup treatmentSetupFromText(const std::string& text, const std::string& name)
{
  return readTreatmentSetup(YamlField::fromText(text, name), name);
}

std::string selfContainedSetup(const std::string& path)
{
  const TreatmentSetup setup = loadTreatmentSetup(path);
  YAML::Node root = YAML::LoadFile(path);
  if (const YAML::Node ct = root["ct"]; ct && !ct.IsNull())
  {
    root["ct"] = resolvePath(ct.Scalar(), path);
  }
  if (const YAML::Node detectors = root["detectors"]; detectors.IsScalar())
  {
    root["detectors"] = YAML::LoadFile(resolvePath(detectors.Scalar(), path))["detectors"];
  }
  if (!setup.ct_choice.series.empty())
  {
    root["ct_series"] = withShortUids(setup.ct_choice.series);  // it goes into bags
  }
  if (setup.target_structure)
  {
    root.remove("target");
    root["target_box_mm"] = nodeOf(setup.target_box);
  }
  root.SetStyle(YAML::EmitterStyle::Block);
  root.remove("frames");
  root.remove("gold_standard");
  for (YAML::Node detector : root["detectors"])
  {
    detector.remove("distortion");
  }
  std::ostringstream text;
  text << root << "\n";
  return text.str();
}

YAML::Node setupNodeFor(const std::string& new_path, const std::string& path)
{
  YamlField::fromFile(path);  // says what is wrong with it
  YAML::Node root = YAML::LoadFile(path);
  if (std::filesystem::absolute(new_path).parent_path() == std::filesystem::absolute(path).parent_path())
  {
    return root;
  }
  const auto relocate = [&path](YAML::Node node)
  {
    if (node && node.IsScalar())
    {
      node = resolvePath(node.Scalar(), path);
    }
  };
  for (const char* const key : { "ct", "detectors", "frames", "gold_standard" })
  {
    relocate(root[key]);
  }
  if (const YAML::Node target = root["target"]; target && target.IsMap())
  {
    relocate(target["rtstruct"]);
  }
  if (const YAML::Node frames = root["frames"]; frames && frames.IsMap() && frames["files"].IsMap())
  {
    for (const auto& pattern : frames["files"])
    {
      relocate(pattern.second);
    }
  }
  return root;
}

void writeSetupNode(const YAML::Node& root, const std::string& path)
{
  std::ofstream file(path);
  file << root << "\n";
  file.close();
  if (!file)
  {
    throw std::runtime_error(path + ": cannot be written");
  }
}

void saveWithInitialPose(const std::string& path, const RigidTransform& room_from_patient, const std::string& new_path)
{
  YAML::Node root = setupNodeFor(new_path, path);
  root["initial_pose"] = nodeOf(room_from_patient);
  writeSetupNode(root, new_path);
}

void saveTreatmentSetup(const TreatmentSetup& setup, const std::string& path)
{
  YAML::Node root;
  if (!setup.ct_path.empty())
  {
    root["ct"] = setup.ct_path;
  }
  root["ct_content"] = nameOf(setup.ct_content);
  if (!setup.ct_choice.series.empty())
  {
    root["ct_series"] = setup.ct_choice.series;
  }
  if (setup.ct_choice.nifti_form != NiftiForm::AGREED)
  {
    root["ct_nifti_form"] = setup.ct_choice.nifti_form == NiftiForm::QFORM ? "qform" : "sform";
  }
  root["intensity"]["kind"] = setup.intensity.kind == IntensityModel::Kind::COUNTS ? "counts" : "attenuation";
  root["intensity"]["offset"] = setup.intensity.offset;
  if (setup.intensity.air_counts)
  {
    root["intensity"]["air_counts"] = *setup.intensity.air_counts;
  }
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    root["detectors"].push_back(detectorNode(detector));
  }
  root["initial_pose"] = nodeOf(setup.room_from_patient);
  root["target_box_mm"] = nodeOf(setup.target_box);
  if (setup.target_structure)
  {
    root["target"]["rtstruct"] = setup.target_structure->file;
    root["target"]["roi"] = setup.target_structure->roi;
  }
  for (const auto& [name, region] : setup.regions)
  {
    root["regions"][name] = nodeOf(region);
  }
  writeSetupNode(root, path);
}

cv::Rect projectedTargetRegion(const TreatmentSetup& setup, const ProjectionGeometry& geometry)
{
  return projectedBoxRegion(setup.target_box, setup.room_from_patient, geometry);
}
}  // namespace xray_tracking
