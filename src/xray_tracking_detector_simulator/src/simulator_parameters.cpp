#include "xray_tracking_detector_simulator/simulator_parameters.h"

#include <stdexcept>
#include <vector>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_detector_simulator/option_check.h"

namespace xray_tracking
{
namespace
{
template <typename T>
void read(const ros::NodeHandle& pnh, const std::string& key, T& value)
{
  value = readParameter(pnh, key, value);
}

void read(const ros::NodeHandle& pnh, const std::string& key, Eigen::Vector3d& value)
{
  std::vector<double> numbers(value.data(), value.data() + 3);
  read(pnh, key, numbers);
  if (numbers.size() != 3)
  {
    throw std::invalid_argument(key + ": " + std::to_string(numbers.size()) + " numbers, expected 3");
  }
  value = Eigen::Vector3d(numbers[0], numbers[1], numbers[2]);
}

void readImage(const ros::NodeHandle& pnh, ImageFormationOptions& image)
{
  read(pnh, "image/polychromatic", image.polychromatic);
  read(pnh, "image/scatter_fraction", image.scatter_fraction);
  read(pnh, "image/scatter_sigma_px", image.scatter_sigma_px);
  read(pnh, "image/blur_sigma_px", image.blur_sigma_px);
  read(pnh, "image/air_quanta", image.air_quanta);
  read(pnh, "image/electronic_noise", image.electronic_noise);
  read(pnh, "image/gain_drift", image.gain_drift);
  read(pnh, "image/offset_drift", image.offset_drift);
  read(pnh, "image/bits", image.bits);
  image.validate();
}

void readMotion(const ros::NodeHandle& pnh, MotionOptions& motion)
{
  std::string type;
  read(pnh, "motion/type", type);
  if (!type.empty())
  {
    motion.type = motionTypeFromName(type);
  }
  read(pnh, "motion/amplitude_mm", motion.amplitude_mm);
  read(pnh, "motion/amplitude_deg", motion.amplitude_deg);
  read(pnh, "motion/period", motion.period);
  read(pnh, "motion/start", motion.start);
  read(pnh, "motion/max_shift_mm", motion.max_shift_mm);
  read(pnh, "motion/max_rotation_deg", motion.max_rotation_deg);
  read(pnh, "motion/csv_file", motion.csv_file);
  read(pnh, "motion/rest_share", motion.rest_share);
  read(pnh, "motion/rest_jitter_mm", motion.rest_jitter_mm);
  motion.validate();
}
}  // namespace

SimulatorParameters readParameters(const ros::NodeHandle& pnh)
{
  SimulatorParameters parameters;
  read(pnh, "source", parameters.source);
  if (parameters.source != "phantom" && parameters.source != "ct")
  {
    throw std::invalid_argument("source: '" + parameters.source + "', expected phantom or ct");
  }
  read(pnh, "setup_file", parameters.setup_file);
  if (parameters.setup_file.empty())
  {
    throw std::invalid_argument("setup_file: empty, expected the path of a treatment's setup");
  }
  read(pnh, "rate", parameters.rate);
  requireInRange("rate", parameters.rate, 0.01, 100.0);
  read(pnh, "exposures", parameters.exposures);
  requireInRange("exposures", parameters.exposures, 0, 1e9);
  read(pnh, "seed", parameters.seed);
  requireInRange("seed", parameters.seed, 0, 2147483647);
  read(pnh, "wait_for_start", parameters.wait_for_start);
  readImage(pnh, parameters.image);
  readMotion(pnh, parameters.motion);
  return parameters;
}
}  // namespace xray_tracking
