#include <cmath>
#include <filesystem>
#include <iostream>
#include <sstream>

#include <boost/math/constants/constants.hpp>

#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
constexpr double kTimeBudget = 60.0;  // nothing waits for it [s]

std::string rivalsInWords(const RegistrationResult& result)
{
  std::ostringstream text;
  text.precision(3);
  for (const Rival& rival : result.rivals)
  {
    text << (text.tellp() == 0 ? "other places: " : ", ") << rival.distance_mm << " mm and "
         << rival.rotation_rad / kDegree << " degrees away with a similarity of " << rival.similarity;
  }
  return text.str().empty() ? "no other place is like the images" : text.str();
}

int alignSequence(const po::variables_map& arguments)
{
  const auto folder = arguments["SEQUENCE_DIR"].as<std::string>();
  const Sequence sequence = loadSequence(folder);
  const TreatmentSetup& setup = sequence.setup;
  if (setup.ct_path.empty())
  {
    throw std::invalid_argument("sequence.yaml: ct is absent, expected the path of a CT to align");
  }
  RegistrationRequest request;
  request.search = Search::WIDE;
  request.max_translation_mm = arguments["max_mm"].as<double>();
  request.max_rotation_rad = arguments["max_degrees"].as<double>() * kDegree;
  request.time_budget = std::chrono::duration<double>(kTimeBudget);
  request.intensity = setup.intensity;
  request.room_from_patient = setup.room_from_patient;
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    request.views.push_back({ setup.detectors[d], sequence.image(0, d) });
  }
  std::cerr << "reading " << setup.ct_path << std::endl;
  const PatientCt ct = readPatientCt(setup.ct_path, setup.ct_content, setup.ct_choice);
  const Registration registration(bodiesOf(ct, targetMaskOf(ct, setup.target_box)), setup.target_box);
  const RegistrationResult result = registration.run(request);
  if (result.status == RegistrationStatus::INVALID)
  {
    throw std::invalid_argument(result.reason);
  }
  const RigidTransform motion = result.room_from_patient * setup.room_from_patient.inverse();
  const Eigen::Vector3d centre = setup.room_from_patient * setup.targetCentre();
  std::ostringstream what;
  what.precision(3);
  what << (motion * centre - centre).norm() << " mm and " << rotationAngle(motion) / kDegree
       << " degrees from the initial pose, similarity " << result.similarity_after << ", probability "
       << result.probability;
  if (result.status != RegistrationStatus::SUCCESS)
  {
    throw std::runtime_error(
        "the first exposure's pose was not found: " + result.reason +
        (result.views.empty() ? "" : "; the best is " + what.str() + "; " + rivalsInWords(result)));
  }
  const auto out = arguments["OUT.yaml"].as<std::string>();
  std::filesystem::create_directories(std::filesystem::absolute(out).parent_path());
  saveWithInitialPose(folder + "/sequence.yaml", result.room_from_patient, out);
  std::cout << "aligned: " << what.str() << "; " << rivalsInWords(result) << std::endl;
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "SEQUENCE_DIR OUT.yaml [--max_mm 45] [--max_degrees 17.8]";
  command_line.description =
      "Finds the patient's pose in a sequence's first exposure where the initial pose is only roughly known, by a "
      "search\nof all that the bounds allow, and writes the sequence.yaml with it. Fails if it is not to be believed.";
  command_line.arguments = { "SEQUENCE_DIR", "OUT.yaml" };
  command_line.options.add_options()(
      "max_mm", po::value<double>()->default_value(xray_tracking::kUsualSearch),
      "how far the target's centre may be from its place at the initial pose, to 100 [mm]")(
      "max_degrees",
      po::value<double>()->default_value(xray_tracking::kUsualSearchRotation / xray_tracking::kDegree, "17.8"),
      "how far it may be turned, to 45 [degrees]");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::alignSequence);
}
