#include <filesystem>
#include <iostream>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "xray_tracking_core/plan/structure.h"
#include "xray_tracking_core/plan/treatment_plan.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_tools/command_line.h"

namespace fs = std::filesystem;
namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
std::string existing(const po::variables_map& arguments, const std::string& name)
{
  const std::string path = arguments[name].as<std::string>();
  if (!fs::exists(path))
  {
    throw std::invalid_argument(name + " " + path + ": no such file or folder");
  }
  return fs::canonical(path).string();
}

std::string textOf(const po::variables_map& arguments, const std::string& option)
{
  return arguments.count(option) != 0 ? arguments[option].as<std::string>() : "";
}

/// @throws std::runtime_error if a detector sees nothing of the target at the initial pose
void requireSeen(const TreatmentSetup& setup, const std::string& detectors_path)
{
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    if (projectedTargetRegion(setup, detector).empty())
    {
      std::ostringstream message;
      message << detectors_path << ": " << detector.name() << " with its source at " << detector.source().transpose()
              << " mm sees nothing of the target, which is at "
              << (setup.room_from_patient * setup.targetCentre()).transpose()
              << " mm in the room: expected detectors in the room's frame, origin in the isocentre, x to the gantry, z "
                 "up (docs/geometry.md), in mm";
      throw std::runtime_error(message.str());
    }
  }
}

int setupFromPlan(const po::variables_map& arguments)
{
  if (arguments.count("detectors") == 0)
  {
    throw std::invalid_argument(
        "--detectors FILE is missing: a YAML file with detectors, as import_geometry writes it; "
        "a plan does not say where the imaging system is");
  }
  TreatmentSetup setup;
  setup.ct_path = existing(arguments, "CT");
  setup.ct_choice.series = textOf(arguments, "series");
  const std::string detectors_path = textOf(arguments, "detectors");
  setup.detectors = loadDetectors(detectors_path);
  setup.target_structure = { existing(arguments, "RTSTRUCT"), textOf(arguments, "roi") };
  const TreatmentPlan plan = readTreatmentPlan(existing(arguments, "RTPLAN"));
  const Structure structure = Structure::read(*setup.target_structure);
  const CtFrame ct = readCtFrame(setup.ct_path, setup.ct_choice.series);
  structure.requireOn(ct);
  requireOn(plan, structure, ct);
  const std::optional<int> number =
      arguments.count("beam") != 0 ? std::make_optional(arguments["beam"].as<int>()) : std::nullopt;
  const PlanBeam& beam = chosenBeam(plan, number);
  setup.target_box = structure.box();
  setup.room_from_patient = roomFromPatient(beam);
  requireSeen(setup, detectors_path);
  const std::string setup_path = arguments["OUT.yaml"].as<std::string>();
  saveTreatmentSetup(setup, setup_path);

  const Eigen::Vector3d centre = setup.targetCentre();
  std::cout << "beam " << beam.number << " '" << beam.name << "': " << beam.patient_position << ", couch "
            << beam.couch_angle << " degrees, isocentre " << beam.isocentre.transpose() << " mm (LPS)\n"
            << "target '" << setup.target_structure->roi << "' of " << setup.target_box.sizes().transpose()
            << " mm about " << centre.transpose() << " mm (LPS), " << (centre - beam.isocentre).norm()
            << " mm from the isocentre\n"
            << "written to " << setup_path << std::endl;
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "CT RTSTRUCT RTPLAN OUT.yaml --roi NAME --detectors FILE [--beam N] [--series UID]";
  command_line.description =
      "Writes a setup file from a treatment plan: the target is a structure of the structure set, and the plan's "
      "isocentre, patient position and couch angles place the CT in the room.";
  command_line.arguments = { "CT", "RTSTRUCT", "RTPLAN", "OUT.yaml" };
  command_line.options.add_options()("roi", po::value<std::string>(),
                                     "the structure's name; if it is none, the message lists all")(
      "detectors", po::value<std::string>(), "YAML file with detectors, in the room's frame (docs/geometry.md)")(
      "beam", po::value<int>(), "number of the beam, where the patient does not lie alike for all")(
      "series", po::value<std::string>(),
      "DICOM series, where the folder holds several CT volumes: as their list has it");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::setupFromPlan);
}
