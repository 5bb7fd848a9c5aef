#include <cmath>
#include <iostream>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_motion_estimation/bone_shape.h"
#include "xray_tracking_motion_estimation/observability.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
int observabilityOfSetup(const po::variables_map& arguments)
{
  const TreatmentSetup setup = loadTreatmentSetup(arguments["SETUP.yaml"].as<std::string>());
  const TrackModel model = trackModelFromName(arguments["model"].as<std::string>());
  const double extent = arguments["extent"].as<double>();
  requireAtLeast("--extent", extent, 1.0);
  const TargetShape of_patient =
      arguments.count("bone") != 0 ? boneShape(setup) : TargetShape::isotropic(setup.targetCentre());

  const Eigen::Vector3d target = setup.room_from_patient * setup.targetCentre();
  const TargetShape shape = of_patient.about(setup.targetCentre(), setup.room_from_patient.linear());

  std::cout << "target's centre at [" << target.transpose() << "] mm; directions in room axes; every track wrong by a "
            << "pixel\n";
  for (const ProjectionGeometry& view : setup.detectors)
  {
    std::cout << view.name() << ": magnification " << view.magnification(target) << ", a pixel is "
              << view.pixelPitch().x() / view.magnification(target) << " mm at the target\n";
  }
  std::cout << describe(observability(setup.detectors, target, shape, model, extent));
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "SETUP.yaml [--model translation] [--extent 25] [--bone]";
  command_line.description =
      "What a geometry tells of the target's motion before any exposure: worst direction, mm a pixel, condition, and "
      "which\nrotations are seen.";
  command_line.arguments = { "SETUP.yaml" };
  command_line.options.add_options()("model", po::value<std::string>()->default_value("translation"),
                                     "what the trackers measure: translation, euclidean, similarity or affine")(
      "extent", po::value<double>()->default_value(25.0),
      "distance from the region's centre at which an error of the linear part makes a pixel [mm]")(
      "bone", "the target's shape is that of the bone in its box; else it is not known");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::observabilityOfSetup);
}
