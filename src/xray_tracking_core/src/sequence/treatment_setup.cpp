#include "xray_tracking_core/sequence/treatment_setup.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "yaml_field.h"

namespace xray_tracking
{
namespace
{
std::string resolvePath(const std::string& path, const std::string& file)
{
  return (std::filesystem::absolute(file).parent_path() / path).lexically_normal().string();
}

ProjectionGeometry readDetector(const YamlField& field)
{
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
  IntensityModel intensity;
  const YamlField kind = field.get("kind");
  if (kind.text() == "attenuation")
  {
    intensity.kind = IntensityModel::Kind::ATTENUATION;
  }
  else if (kind.text() != "counts")
  {
    kind.fail("counts or attenuation");
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

YAML::Node nodeOf(const ProjectionGeometry& detector)
{
  YAML::Node node;
  node["name"] = detector.name();
  node["image_size"] = listOf(detector.imageSize());
  node["pixel_pitch_mm"] = listOf(detector.pixelPitch());
  node["source_mm"] = listOf(detector.source());
  node["origin_mm"] = listOf(detector.origin());
  node["x_direction"] = listOf(detector.xDirection());
  node["y_direction"] = listOf(detector.yDirection());
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

std::vector<ProjectionGeometry> loadDetectors(const std::string& path)
{
  return readDetectors(YamlField::fromFile(path).get("detectors"));
}

namespace
{
/// @param path of the file, where relative paths start
TreatmentSetup readTreatmentSetup(const YamlField& root, const std::string& path)
{
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
  const YamlField detectors = root.get("detectors");
  setup.detectors =
      detectors.isScalar() ? loadDetectors(resolvePath(detectors.text(), path)) : readDetectors(detectors);
  setup.room_from_patient = readPose(root.get("initial_pose"));
  setup.target_box = readBox(root.get("target_box_mm"));
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
  loadTreatmentSetup(path);
  YAML::Node root = YAML::LoadFile(path);
  if (const YAML::Node ct = root["ct"]; ct && !ct.IsNull())
  {
    root["ct"] = resolvePath(ct.Scalar(), path);
  }
  if (const YAML::Node detectors = root["detectors"]; detectors.IsScalar())
  {
    root["detectors"] = YAML::LoadFile(resolvePath(detectors.Scalar(), path))["detectors"];
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
    root["detectors"].push_back(nodeOf(detector));
  }
  const Eigen::Quaterniond rotation(setup.room_from_patient.linear());
  root["initial_pose"]["translation_mm"] = listOf(Eigen::Vector3d(setup.room_from_patient.translation()));
  root["initial_pose"]["rotation_xyzw"] = listOf(rotation.coeffs());
  root["target_box_mm"]["min"] = listOf(setup.target_box.min());
  root["target_box_mm"]["max"] = listOf(setup.target_box.max());
  for (const auto& [name, region] : setup.regions)
  {
    root["regions"][name] = nodeOf(region);
  }

  std::ofstream file(path);
  file << root << "\n";
  file.close();
  if (!file)
  {
    throw std::runtime_error(path + ": cannot be written");
  }
}

cv::Rect projectedTargetRegion(const TreatmentSetup& setup, const ProjectionGeometry& geometry)
{
  Eigen::AlignedBox2d seen;
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Vector3d point = setup.target_box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner));
    const Eigen::Vector2d pixel = geometry.project(setup.room_from_patient * point);
    if (!pixel.allFinite())
    {
      return {};
    }
    seen.extend(pixel);
  }
  // A pixel reaches half its width around its centre. Clipped before conversion, which large values would not survive.
  const Eigen::Array2d size = geometry.imageSize().cast<double>().array();
  const Eigen::Array2d first = (seen.min().array() + 0.5).floor().max(0.0).min(size);
  const Eigen::Array2d end = ((seen.max().array() + 0.5).floor() + 1.0).max(0.0).min(size);
  if ((first >= end).any())
  {
    return {};
  }
  return { cv::Point(int(first.x()), int(first.y())), cv::Point(int(end.x()), int(end.y())) };
}
}  // namespace xray_tracking
