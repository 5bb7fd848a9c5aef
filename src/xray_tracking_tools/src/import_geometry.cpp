#include <filesystem>
#include <iostream>

#include "recording_check/pose_readings.h"
#include "xray_tracking_core/geometry/geometry_import.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
template <typename Value>
std::vector<Value> listOf(const po::variables_map& arguments, const std::string& option)
{
  return arguments.count(option) != 0 ? arguments[option].as<std::vector<Value>>() : std::vector<Value>();
}

template <typename Value>
void requireCount(const std::string& option, const std::vector<Value>& values, std::size_t least, std::size_t most)
{
  if (!values.empty() && (values.size() < least || values.size() > most))
  {
    throw std::invalid_argument("--" + option + " has " + std::to_string(values.size()) + " values, expected " +
                                std::to_string(least) + (most > least ? " or " + std::to_string(most) : ""));
  }
}

GeometryImportOptions optionsOf(const po::variables_map& arguments)
{
  GeometryImportOptions options;
  const auto size = listOf<int>(arguments, "image_size");
  requireCount("image_size", size, 2, 2);
  if (!size.empty())
  {
    options.image_size = Eigen::Vector2i(size[0], size[1]);
  }
  const auto pitch = listOf<double>(arguments, "pitch");
  requireCount("pitch", pitch, 1, 2);
  if (!pitch.empty())
  {
    options.pixel_pitch = Eigen::Vector2d(pitch.front(), pitch.back());
  }
  if (arguments.count("sdd") != 0)
  {
    options.source_to_detector = arguments["sdd"].as<double>();
  }
  if (arguments.count("unit") != 0)
  {
    const std::string& unit = arguments["unit"].as<std::string>();
    if (unit != "mm" && unit != "cm" && unit != "m")
    {
      throw std::invalid_argument("--unit is " + unit + ", expected mm, cm or m");
    }
    options.unit = unit == "mm" ? 1.0 : unit == "cm" ? 10.0 : 1000.0;
  }
  const auto point = listOf<double>(arguments, "point");
  requireCount("point", point, 3, 3);
  if (!point.empty())
  {
    options.point = Eigen::Vector3d(point.data());
  }
  options.projections = listOf<int>(arguments, "projections");
  options.names = listOf<std::string>(arguments, "names");
  for (const std::string& name : listOf<std::string>(arguments, "flip_rows"))
  {
    options.flip_rows.insert(name);
  }
  for (const std::string& name : listOf<std::string>(arguments, "flip_columns"))
  {
    options.flip_columns.insert(name);
  }
  return options;
}

/// Names of the detectors in a setup, by which tables of frames and regions go; none if it has no good ones.
std::vector<std::string> namesIn(const std::string& path)
{
  std::vector<std::string> names;
  try
  {
    for (const ProjectionGeometry& detector : loadDetectors(path))
    {
      names.push_back(detector.name());
    }
  }
  catch (const std::exception&)
  {
  }
  return names;
}

/// What can be said of the setup that came of it, if it is one.
/// @param point that all views see
void checkSetup(const std::string& path, const std::optional<Eigen::Vector3d>& point)
{
  TreatmentSetup setup;
  try
  {
    setup = loadTreatmentSetup(path);
  }
  catch (const std::exception& error)
  {
    std::cout << "not yet a whole setup: " << error.what() << "\n";
    return;
  }
  const std::vector<Finding> findings = checkRoom(setup);
  for (const Finding& finding : findings)
  {
    std::cout << lineOf(finding) << "\n";
  }
  if (!findings.empty() && point)
  {
    const Eigen::Vector3d translation = *point - setup.room_from_patient.linear() * setup.targetCentre();
    const Eigen::IOFormat list(7, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
    std::cout << "initial_pose with translation_mm: " << translation.format(list)
              << " puts the target where all views see it\n";
  }
}

int importDetectors(const po::variables_map& arguments)
{
  const std::string out = arguments["OUT.yaml"].as<std::string>();
  const std::string into = arguments.count("into") != 0 ? arguments["into"].as<std::string>() : "";
  const auto files = listOf<std::string>(arguments, "views");
  if (files.empty())
  {
    throw std::invalid_argument("--views is missing, expected the files to import");
  }
  for (const std::string& file : files)
  {
    std::error_code none;
    if (std::filesystem::equivalent(file, out, none))
    {
      throw std::invalid_argument(out + " is one of --views: expected another file, as it would be overwritten");
    }
  }
  GeometryImportOptions options = optionsOf(arguments);
  options.default_names = into.empty() ? std::vector<std::string>() : namesIn(into);
  const ImportedGeometry imported = importGeometry(files, options);
  writeDetectors(imported, out, into);
  for (const std::string& remark : imported.remarks)
  {
    std::cout << remark << "\n";
  }
  checkSetup(out, imported.point);
  std::cout << imported.detectors.size() << " detectors written to " << out << std::endl;
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  using Texts = std::vector<std::string>;
  xray_tracking::CommandLine command_line;
  command_line.usage = "OUT.yaml --views FILE ... [--into SETUP.yaml] [--pitch MM [MM] | --sdd MM] [...]";
  command_line.description =
      "Reads the detectors from files of other programs (MayaCam 2.0, 3 x 4 projection matrices, RTK's geometry, "
      "DICOM\n"
      "X-ray and RT images, a YAML list), which are recognised, and writes them as `detectors` of a setup.";
  command_line.arguments = { "OUT.yaml" };
  command_line.options.add_options()("views", po::value<Texts>()->multitoken(),
                                     "files of one form, one view or more each")(
      "into", po::value<std::string>(), "setup or sequence.yaml whose other keys are kept in OUT.yaml")(
      "pitch", po::value<std::vector<double>>()->multitoken(),
      "pixel pitch on the panel, where the files have none, along columns and along rows [mm]")(
      "sdd", po::value<double>(), "instead: distance from source to panel, where the files have none [mm]")(
      "image_size", po::value<std::vector<int>>()->multitoken(), "columns and rows, where the files have none [px]")(
      "unit", po::value<std::string>(),
      "of the files' coordinates: mm, cm or m; default mm, if distances are plausible")(
      "point", po::value<std::vector<double>>()->multitoken(),
      "a room point that all views see [mm]; default: where the rays through their middles meet")(
      "projections", po::value<std::vector<int>>()->multitoken(), "of an RTK file, from 0")(
      "names", po::value<Texts>()->multitoken(),
      "of the detectors; default: the file's, those of --into, or detector_a, detector_b ...")(
      "flip_rows", po::value<Texts>()->multitoken(), "detectors whose images are turned upside down against the files")(
      "flip_columns", po::value<Texts>()->multitoken(),
      "detectors whose images are turned left to right against the files");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::importDetectors);
}
