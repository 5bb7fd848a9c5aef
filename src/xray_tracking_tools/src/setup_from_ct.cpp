#include <cmath>
#include <filesystem>
#include <iostream>
#include <sstream>

#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
Eigen::Vector3d targetCentre(const po::variables_map& arguments, const std::string& ct_path, const CtChoice& choice,
                             double edge)
{
  if (arguments.count("target") == 0)
  {
    std::cerr << "reading " << ct_path << std::endl;
    return findBonyTarget(readCtVolume(ct_path, choice), edge);
  }
  const std::vector<double>& target = arguments["target"].as<std::vector<double>>();
  const Eigen::Vector3d centre = target.size() == 3 ? Eigen::Vector3d(target.data()) : Eigen::Vector3d::Constant(NAN);
  if (!centre.allFinite())
  {
    throw std::invalid_argument("--target has " + std::to_string(target.size()) + " values, expected 3 finite ones");
  }
  std::cerr << "reading " << ct_path << std::endl;
  const Eigen::AlignedBox3d extent = readPatientCt(ct_path, CtContent::RECOGNISED, choice).volume.grid.extent();
  if (!extent.contains(centre) || !(edge <= extent.sizes().maxCoeff()))
  {
    std::ostringstream message;
    message << "--target is " << centre.transpose() << " mm with an --edge of " << edge << " mm, but " << ct_path
            << " reaches from " << extent.min().transpose() << " to " << extent.max().transpose()
            << " mm: expected a point of it (LPS, mm) and an edge that is not longer than it";
    throw std::invalid_argument(message.str());
  }
  return centre;
}

int setupFromCt(const po::variables_map& arguments)
{
  const std::string ct_path = arguments["CT"].as<std::string>();
  const std::string setup_path = arguments["OUT.yaml"].as<std::string>();
  const double edge = arguments["edge"].as<double>();
  requireAtLeast("--edge", edge, 1.0);
  if (!std::filesystem::exists(ct_path))
  {
    throw std::invalid_argument(ct_path + ": no such file or folder");
  }
  TreatmentSetup setup;
  if (arguments.count("series") != 0)
  {
    setup.ct_choice.series = arguments["series"].as<std::string>();
  }
  if (arguments.count("nifti_form") != 0)
  {
    const std::string form = arguments["nifti_form"].as<std::string>();
    if (form != "qform" && form != "sform")
    {
      throw std::invalid_argument("--nifti_form is " + form + ", expected qform or sform");
    }
    setup.ct_choice.nifti_form = form == "qform" ? NiftiForm::QFORM : NiftiForm::SFORM;
  }
  const Eigen::Vector3d centre = targetCentre(arguments, ct_path, setup.ct_choice, edge);

  setup.ct_path = std::filesystem::canonical(ct_path).string();
  setup.intensity.offset = 100.0;
  setup.intensity.air_counts = 60000.0;
  setup.detectors = loadDetectors(coreConfigPath("geometry/cyberknife.yaml"));
  const Eigen::Vector3d half_edge = Eigen::Vector3d::Constant(0.5 * edge);
  setup.target_box = Eigen::AlignedBox3d(centre - half_edge, centre + half_edge);
  // Supine, superior along room x; the box centre comes to lie in the isocentre.
  const Eigen::Quaterniond room_from_patient(-0.5, 0.5, -0.5, 0.5);  // w, x, y, z
  setup.room_from_patient = makeRigidTransform(-(room_from_patient * centre), room_from_patient);
  saveTreatmentSetup(setup, setup_path);
  std::cout << "target centre " << centre.transpose() << " mm, written to " << setup_path << std::endl;
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "CT OUT.yaml [--target X Y Z] [--edge 50] [--series UID] [--nifti_form qform|sform]";
  command_line.description =
      "Writes a setup file for a CT of which nothing else is known: CyberKnife geometry, the target in the isocentre.";
  command_line.arguments = { "CT", "OUT.yaml" };
  command_line.options.add_options()("target", po::value<std::vector<double>>()->multitoken(),
                                     "target's centre, patient frame (LPS) [mm]; default: where most bone is")(
      "edge", po::value<double>()->default_value(50.0), "edge of the target box [mm]")(
      "series", po::value<std::string>(),
      "DICOM series, where the folder holds several CT volumes: as their list has it")(
      "nifti_form", po::value<std::string>(), "which one holds where a NIfTI file's qform and sform differ");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::setupFromCt);
}
