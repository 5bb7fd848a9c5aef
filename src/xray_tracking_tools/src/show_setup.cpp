#include <filesystem>
#include <iostream>

#include <opencv2/imgcodecs.hpp>

#include "recording_check/pose_readings.h"
#include "setup_picture/likeness.h"
#include "setup_picture/setup_picture.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
/// Those of the command line, or of the first exposure where the setup is that of a sequence.
std::vector<std::string> imageFiles(const std::vector<std::string>& given, const std::string& setup_path)
{
  const std::filesystem::path path(setup_path);
  if (given.empty() && path.filename() == "sequence.yaml")
  {
    return loadSequence(std::filesystem::absolute(path).parent_path().string()).exposures.front().files;
  }
  return given;
}

void addCt(const TreatmentSetup& setup, SetupPictureContent& content)
{
  std::cerr << "reading " << setup.ct_path << std::endl;
  const PatientCt ct = readPatientCt(setup.ct_path, setup.ct_content, setup.ct_choice);
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Vector3d upper(corner & 1, corner >> 1 & 1, corner >> 2);
    content.ct_corners.push_back(
        ct.volume.grid.patient_from_index *
        (upper.cwiseProduct(ct.volume.grid.size.cast<double>()) - Eigen::Vector3d::Constant(0.5)));
  }
  if (!ct.volume.grid.extent().intersects(setup.target_box))
  {
    content.faults.push_back("target_box_mm is outside the CT: expected it in the patient frame, LPS mm as the CT has");
  }
  const ShearWarpRenderer renderer(bodiesOf(ct, std::nullopt).target);
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    content.drrs.emplace_back();
    renderer.render(detector, setup.room_from_patient, content.drrs.back());
  }
  if (!content.xrays.empty())
  {
    const Likeness likeness = likenessOf(setup, renderer, content.xrays);
    content.likeness = likeness.views;
    content.faults.insert(content.faults.end(), likeness.words.begin(), likeness.words.end());
  }
}

int showSetup(const po::variables_map& arguments)
{
  std::string setup_path = arguments["SETUP.yaml"].as<std::string>();
  if (std::filesystem::is_directory(setup_path))
  {
    setup_path += "/sequence.yaml";
  }
  std::vector<std::string> images;
  if (arguments.count("images") != 0)
  {
    images = arguments["images"].as<std::vector<std::string>>();
  }
  const TreatmentSetup setup = loadTreatmentSetup(setup_path);
  std::string picture_path;
  if (arguments.count("OUT.png") != 0)
  {
    picture_path = arguments["OUT.png"].as<std::string>();
  }
  else if (images.size() > setup.detectors.size())
  {
    picture_path = images.back();  // behind the images
    images.pop_back();
  }
  else
  {
    throw std::invalid_argument("OUT.png is missing");
  }
  images = imageFiles(images, setup_path);
  if (!images.empty() && images.size() != setup.detectors.size())
  {
    throw std::invalid_argument("--images: " + std::to_string(images.size()) + ": expected one of each of the " +
                                std::to_string(setup.detectors.size()) + " detectors");
  }

  SetupPictureContent content;
  content.title = setup_path;
  for (const Finding& finding : checkRoom(setup))
  {
    content.faults.push_back(lineOf(finding));
  }
  const std::vector<LensDistortion> distortions = loadDistortions(setup_path, setup.detectors);
  for (std::size_t d = 0; d < images.size(); ++d)
  {
    const cv::Mat image = readXrayImage(images[d], setup.detectors[d], setup.intensity);
    content.xrays.push_back(distortions[d].undo(image, setup.intensity.kind));
  }
  if (!setup.ct_path.empty())
  {
    addCt(setup, content);
  }
  const cv::Mat picture = drawSetup(setup, content);
  bool written = false;
  try
  {
    written = cv::imwrite(picture_path, picture);
  }
  catch (const cv::Exception&)  // of an ending that is no picture's
  {
  }
  if (!written)
  {
    throw std::runtime_error(picture_path + ": cannot be written; expected a path that ends with .png or .jpg");
  }
  for (const std::string& fault : content.faults)
  {
    std::cout << fault << "\n";
  }
  std::cout << "written to " << picture_path << std::endl;
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "SETUP.yaml|SEQUENCE_DIR OUT.png [--images FILE ...]";
  command_line.description =
      "Draws a setup: the room from three sides, and of every detector the X-ray beside the DRR at the initial pose, "
      "with\nthe target's box, the patient's directions and lengths. What is wrong with a convention is seen there.";
  command_line.arguments = { "SETUP.yaml" };
  command_line.optional_arguments = { "OUT.png" };
  command_line.options.add_options()("images", po::value<std::vector<std::string>>()->multitoken(),
                                     "one X-ray of every detector, in their order; of a sequence.yaml: the first "
                                     "exposure's");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::showSetup);
}
