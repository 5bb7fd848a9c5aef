#include "xray_tracking_tools/exposure_set.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include <ros/package.h>
#include <boost/math/constants/constants.hpp>

#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
namespace
{
ExposureSet sequenceExposures(const std::string& folder)
{
  const Sequence sequence = loadSequence(folder);
  ExposureSet set;
  set.setup = sequence.setup;
  for (std::size_t k = 0; k < sequence.exposures.size(); ++k)
  {
    std::vector<cv::Mat> images;
    for (std::size_t d = 0; d < sequence.setup.detectors.size(); ++d)
    {
      images.push_back(sequence.image(k, d));
    }
    set.images.push_back(images);
  }
  for (const StampedPose& pose : sequence.gold_standard)
  {
    set.room_from_patient.push_back(pose.room_from_patient);
  }
  return set;
}

cv::Mat countsFromMaterials(const cv::Mat& soft, const cv::Mat& bone, const IntensityModel& intensity, cv::RNG& random)
{
  constexpr double kDefaultAirCounts = 60000.0;
  const double primary = intensity.air_counts.value_or(kDefaultAirCounts) - intensity.offset;
  cv::Mat counts = -kWaterAttenuation * soft - kBoneAttenuation * bone;
  cv::exp(counts, counts);
  counts *= primary;
  cv::Mat noise(counts.size(), CV_32FC1), deviation;
  random.fill(noise, cv::RNG::NORMAL, 0.0, 1.0);
  cv::sqrt(counts, deviation);
  counts += noise.mul(deviation) + intensity.offset;
  cv::Mat image;
  counts.convertTo(image, CV_16UC1);
  return image;
}

ExposureSet phantomExposures(const std::string& setup_file)
{
  constexpr int kExposures = 20;
  constexpr double kAmplitude = 10.0;  // [mm]
  const NeckPhantom phantom;
  cv::RNG random(1);
  Progress progress("phantom exposure");
  ExposureSet set;
  set.setup = loadTreatmentSetup(setup_file);
  if (set.setup.intensity.kind != IntensityModel::Kind::COUNTS)
  {
    throw std::runtime_error(setup_file + ": intensity.kind is attenuation, expected counts for the phantom");
  }
  for (int k = 0; k < kExposures; ++k)
  {
    const double phase = boost::math::constants::half_pi<double>() * k / (kExposures - 1);
    const Eigen::Vector3d shift = kAmplitude * std::sin(phase) * Eigen::Vector3d(0.6, -0.48, 0.64);
    const RigidTransform room_from_patient = Eigen::Translation3d(shift) * set.setup.room_from_patient;
    std::vector<cv::Mat> images;
    for (const ProjectionGeometry& detector : set.setup.detectors)
    {
      cv::Mat soft, bone;
      phantom.lineIntegrals(detector, room_from_patient, room_from_patient, soft, bone);
      images.push_back(countsFromMaterials(soft, bone, set.setup.intensity, random));
    }
    set.images.push_back(images);
    set.room_from_patient.push_back(room_from_patient);
    progress(k + 1, kExposures);
  }
  return set;
}
}  // namespace

ExposureSet loadExposureSet(const std::string& path)
{
  const std::filesystem::path file(path);
  if (std::filesystem::is_directory(file))
  {
    return sequenceExposures(path);
  }
  if (file.filename() == "sequence.yaml")
  {
    return sequenceExposures(file.parent_path().string());
  }
  return phantomExposures(path);
}

std::size_t backAndForth(std::size_t k, std::size_t count)
{
  const std::size_t period = std::max<std::size_t>(2 * (count - 1), 1);
  return std::min(k % period, period - k % period);
}

std::string coreConfigPath(const std::string& name)
{
  const std::string package = ros::package::getPath("xray_tracking_core");
  if (package.empty())
  {
    throw std::runtime_error("the package xray_tracking_core is not on ROS_PACKAGE_PATH");
  }
  return package + "/config/" + name;
}
}  // namespace xray_tracking
