#include "xray_tracking_detector_simulator/simulator_parameters.h"

#include <vector>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
template <typename T>
void read(ParameterReader& reader, const std::string& key, T& value)
{
  value = reader.read(key, value);
}

void read(ParameterReader& reader, const std::string& key, Eigen::Vector3d& value)
{
  std::vector<double> numbers(value.data(), value.data() + 3);
  read(reader, key, numbers);
  requireOption(numbers.size() == 3, "the length of " + key, numbers.size(), "3 numbers");
  value = Eigen::Vector3d(numbers[0], numbers[1], numbers[2]);
}

void readImage(ParameterReader& reader, ImageFormationOptions& image)
{
  read(reader, "image/polychromatic", image.polychromatic);
  read(reader, "image/scatter_fraction", image.scatter_fraction);
  read(reader, "image/scatter_sigma_px", image.scatter_sigma_px);
  read(reader, "image/blur_sigma_px", image.blur_sigma_px);
  read(reader, "image/air_quanta", image.air_quanta);
  read(reader, "image/electronic_noise", image.electronic_noise);
  read(reader, "image/gain_drift", image.gain_drift);
  read(reader, "image/offset_drift", image.offset_drift);
  read(reader, "image/bits", image.bits);
  image.validate();
}

void readMotion(ParameterReader& reader, MotionOptions& motion)
{
  std::string type;
  read(reader, "motion/type", type);
  if (!type.empty())
  {
    motion.type = motionTypeFromName(type);
  }
  read(reader, "motion/amplitude_mm", motion.amplitude_mm);
  read(reader, "motion/amplitude_deg", motion.amplitude_deg);
  read(reader, "motion/period", motion.period);
  read(reader, "motion/start", motion.start);
  read(reader, "motion/max_shift_mm", motion.max_shift_mm);
  read(reader, "motion/max_rotation_deg", motion.max_rotation_deg);
  read(reader, "motion/csv_file", motion.csv_file);
  read(reader, "motion/rest_share", motion.rest_share);
  read(reader, "motion/rest_jitter_mm", motion.rest_jitter_mm);
  motion.validate();
}
}  // namespace

SimulatorParameters readParameters(ParameterReader reader)
{
  SimulatorParameters parameters;
  read(reader, "source", parameters.source);
  requireOption(parameters.source == "phantom" || parameters.source == "ct", "source", "'" + parameters.source + "'",
                "phantom or ct");
  read(reader, "setup_file", parameters.setup_file);
  requireOption(!parameters.setup_file.empty(), "setup_file", "empty", "the path of a treatment's setup");
  read(reader, "rate", parameters.rate);
  requireInRange("rate", parameters.rate, 0.01, 100.0);
  read(reader, "exposures", parameters.exposures);
  requireInRange("exposures", parameters.exposures, 0, 1e9);
  read(reader, "seed", parameters.seed);
  requireInRange("seed", parameters.seed, 0, 2147483647);
  read(reader, "wait_for_start", parameters.wait_for_start);
  readImage(reader, parameters.image);
  readMotion(reader, parameters.motion);
  reader.warnOfUnread();
  return parameters;
}
}  // namespace xray_tracking
