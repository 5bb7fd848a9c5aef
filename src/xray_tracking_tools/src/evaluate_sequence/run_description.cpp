#include "run_description.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <memory>
#include <sstream>
#include <stdexcept>

#include <openssl/evp.h>
#include <boost/version.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "revision.h"
#include "xray_tracking_core/image/attenuation.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_motion_estimation/motion_monitor_options.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
namespace
{
using nlohmann::json;

class Sha256
{
public:
  Sha256() { EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr); }
  void add(const void* data, std::size_t bytes) { EVP_DigestUpdate(context_.get(), data, bytes); }
  std::string hex()
  {
    std::array<unsigned char, 32> digest;
    EVP_DigestFinal_ex(context_.get(), digest.data(), nullptr);
    std::ostringstream text;
    text << std::hex << std::setfill('0');
    for (const unsigned char byte : digest)
    {
      text << std::setw(2) << static_cast<int>(byte);
    }
    return text.str();
  }

private:
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_{ EVP_MD_CTX_new(), EVP_MD_CTX_free };
};

std::string sha256OfFile(const std::string& path)
{
  std::ifstream file(path, std::ios::binary);
  Sha256 sha;
  std::vector<char> buffer(1 << 20);
  while (file.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) || file.gcount() > 0)
  {
    sha.add(buffer.data(), static_cast<std::size_t>(file.gcount()));
  }
  if (!file.eof())
  {
    throw std::runtime_error(path + ": cannot be read");
  }
  return sha.hex();
}

/// Of one file its own, of several that of what `sha256sum` prints of them: a line each, hash, two spaces, name without
/// folder, ordered as given.
json describeFiles(const std::string& what, const std::vector<std::string>& files)
{
  std::uintmax_t bytes = 0;
  std::string lines;
  std::string hash;
  for (const std::string& file : files)
  {
    bytes += std::filesystem::file_size(file);
    hash = sha256OfFile(file);
    lines += hash + "  " + std::filesystem::path(file).filename().string() + "\n";
  }
  if (files.size() != 1)
  {
    Sha256 sha;
    sha.add(lines.data(), lines.size());
    hash = sha.hex();
  }
  return { { "what", what }, { "files", files.size() }, { "bytes", bytes }, { "sha256", hash } };
}

/// A volume file, or all files of its folder by name.
std::vector<std::string> ctFiles(const std::string& path)
{
  if (!std::filesystem::is_directory(path))
  {
    return { path };
  }
  std::vector<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(path))
  {
    if (entry.is_regular_file())
    {
      files.push_back(entry.path().string());
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

std::string processorName()
{
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);)
  {
    if (line.rfind("model name", 0) == 0)
    {
      return line.substr(std::min(line.size(), line.find(':') + 2));
    }
  }
  return "";
}

json listOf(const Eigen::Ref<const Eigen::VectorXd>& vector)
{
  return std::vector<double>(vector.data(), vector.data() + vector.size());
}

json describeSetup(const TreatmentSetup& setup)
{
  json detectors = json::array();
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    const auto region = setup.regions.find(detector.name());
    const cv::Rect roi = region != setup.regions.end() ? region->second : projectedTargetRegion(setup, detector);
    detectors.push_back({ { "name", detector.name() },
                          { "image_size", { detector.imageSize().x(), detector.imageSize().y() } },
                          { "pixel_pitch_mm", listOf(detector.pixelPitch()) },
                          { "source_mm", listOf(detector.source()) },
                          { "origin_mm", listOf(detector.origin()) },
                          { "x_direction", listOf(detector.xDirection()) },
                          { "y_direction", listOf(detector.yDirection()) },
                          { "region", { roi.x, roi.y, roi.width, roi.height } } });
  }
  const Eigen::Quaterniond rotation(setup.room_from_patient.linear());
  const bool counts = setup.intensity.kind == IntensityModel::Kind::COUNTS;
  return { { "detectors", detectors },
           { "target_box_mm",
             { { "min", listOf(setup.target_box.min()) }, { "max", listOf(setup.target_box.max()) } } },
           { "initial_pose",
             { { "translation_mm", listOf(setup.room_from_patient.translation()) },
               { "rotation_xyzw", listOf(rotation.coeffs()) } } },
           { "intensity", { { "kind", counts ? "counts" : "attenuation" }, { "offset", setup.intensity.offset } } },
           { "ct_content", nameOf(setup.ct_content) } };
}

std::string describeAir(const ExposureSource& source)
{
  const IntensityModel& intensity = source.setup.intensity;
  std::ostringstream text;
  if (intensity.kind != IntensityModel::Kind::COUNTS)
  {
    text << "none: attenuation";
  }
  else if (intensity.air_counts)
  {
    text << *intensity.air_counts;
  }
  else
  {
    text << "estimated in each image as its brightest pixel; of the first exposure";
    const std::vector<cv::Mat> images = source.images(0);
    for (std::size_t d = 0; d < images.size(); ++d)
    {
      text << (d == 0 ? " " : ", ") << airCounts(images[d], intensity) << " of " << source.setup.detectors[d].name();
    }
  }
  return text.str();
}

/// The defaults that all methods but the paper's run with, which has its own (offline_run.cpp, paper_registration.cpp).
json describeSettings(const ExposureSource& source)
{
  const TrackerParameters tracker;
  const MotionMonitorOptions monitor;
  const RegistrationOptions registration;
  return { { "air counts", describeAir(source) },
           { "tracker model", tracker.model_by_data ? "by data: euclidean or translation" : "fixed" },
           { "tracker resolution [mm]", tracker.resolution },
           { "tracker ranges [mm]", tracker.ranges },
           { "registration optimiser",
             registration.optimiser == Optimiser::GAUSS_NEWTON ? "Levenberg-Marquardt" : "BOBYQA" },
           { "registration min. probability", registration.min_probability },
           { "registration deadline", "none: offline, nothing is late" },
           { "gate max. displacement [mm]", monitor.gate.max_displacement },
           { "gate max. rotation [rad]", monitor.gate.max_rotation },
           { "gate max. sigma [mm]", monitor.gate.max_sigma },
           { "gate max. tracked sigma [mm]", monitor.gate.max_tracked_sigma },
           { "gate max. speed [mm/s]", monitor.gate.max_speed },
           { "gate good exposures", monitor.gate.good_exposures } };
}
}  // namespace

json describeRun(const ExposureSource& source, const std::vector<std::string>& methods)
{
  json inputs = json::array();
  for (const InputFiles& input : source.inputs)
  {
    inputs.push_back(describeFiles(input.what, input.files));
  }
  if (!source.setup.ct_path.empty())
  {
    inputs.push_back(describeFiles("CT", ctFiles(source.setup.ct_path)));
  }
  return { { "program",
             { { "version", kVersion },
               { "revision", kRevision },
               { "compiler", __VERSION__ },
               { "OpenCV", CV_VERSION },
               { "Eigen", std::to_string(EIGEN_WORLD_VERSION) + "." + std::to_string(EIGEN_MAJOR_VERSION) + "." +
                              std::to_string(EIGEN_MINOR_VERSION) },
               { "Boost", BOOST_LIB_VERSION } } },
           { "processor", processorName() },
           { "source", source.path },
           { "methods", methods },
           { "inputs", inputs },
           { "setup", describeSetup(source.setup) },
           { "settings", describeSettings(source) } };
}
}  // namespace xray_tracking
