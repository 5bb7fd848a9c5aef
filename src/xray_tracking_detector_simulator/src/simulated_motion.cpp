#include "xray_tracking_detector_simulator/simulated_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "xray_tracking_core/option_check.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
constexpr std::array<std::pair<const char*, MotionType>, 8> kTypes = { {
    { "none", MotionType::NONE },
    { "drift", MotionType::DRIFT },
    { "step", MotionType::STEP },
    { "breathing", MotionType::BREATHING },
    { "swallow", MotionType::SWALLOW },
    { "random_walk", MotionType::RANDOM_WALK },
    { "drift_and_breathing", MotionType::DRIFT_AND_BREATHING },
    { "csv", MotionType::CSV },
} };

/// Numbers of motions are kept apart from those of images, which come from the same seed.
constexpr std::uint64_t kMotionPart = 0x6d6f74696f6e;

double radians(double degrees)
{
  return degrees * EIGEN_PI / 180.0;
}

double square(double value)
{
  return value * value;
}

/// From 0 at 0 to 1 at 1 without a kink (smoothstep).
double ease(double x)
{
  const double t = std::clamp(x, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

/// Shortens a vector to less than `bound`, smoothly: by 8 % at the bound, by next to nothing below 70 % of it.
Eigen::Vector3d bounded(const Eigen::Vector3d& v, double bound)
{
  if (bound <= 0.0)
  {
    return Eigen::Vector3d::Zero();
  }
  return v / std::pow(1.0 + std::pow(v.norm() / bound, 8), 1.0 / 8);
}

/// Waves whose power falls with the square of the frequency, as a random walk's does, with phases at random; the
/// slowest has the given period, the fastest stays resolved by whole exposures. Starts at 0 and stays within -2 .. 2.
double randomWalk(const RandomStream& stream, int exposure, double period)
{
  constexpr double kSpacing = 1.7;  // of the frequencies; a wave stands for a band as wide as its frequency
  double sum = 0.0;
  double amplitudes = 0.0;
  double frequency = 1.0 / period;
  for (std::uint64_t wave = 0; wave == 0 || (wave < 10 && frequency < 0.25); ++wave)
  {
    const double amplitude = 1.0 / std::sqrt(frequency);
    const double phase = stream.uniform(wave);
    sum += amplitude * (std::sin(2.0 * EIGEN_PI * (frequency * exposure + phase)) - std::sin(2.0 * EIGEN_PI * phase));
    amplitudes += amplitude;
    frequency *= kSpacing;
  }
  return sum / amplitudes;
}

std::vector<RigidTransform> readPoses(const std::string& path, const RigidTransform& first)
{
  std::vector<RigidTransform> poses;
  for (const StampedPose& pose : loadPoses(path))
  {
    poses.push_back(pose.room_from_patient);
  }
  if (poses.empty())
  {
    throw std::runtime_error(path + ": no poses");
  }
  // What rounding in files amounts to; more is a file of another treatment, and would be a jump after exposure 0.
  const double shift = (poses.front().translation() - first.translation()).norm();
  const double angle = rotationAngle(first.inverse() * poses.front());
  if (shift > 0.01 || angle > radians(0.01))
  {
    std::ostringstream text;
    text << path << ": the first pose is " << shift << " mm and " << angle * 180.0 / EIGEN_PI
         << " degrees off the setup's initial_pose, expected the same pose";
    throw std::runtime_error(text.str());
  }
  return poses;
}
}  // namespace

MotionType motionTypeFromName(const std::string& name)
{
  std::string names;
  for (const auto& [known, type] : kTypes)
  {
    if (name == known)
    {
      return type;
    }
    names += std::string(names.empty() ? "" : ", ") + known;
  }
  throw std::invalid_argument("motion/type is '" + name + "', expected one of " + names);
}

void MotionOptions::validate() const
{
  for (int axis = 0; axis < 3; ++axis)
  {
    const std::string element = "[" + std::to_string(axis) + "]";
    requireInRange("motion/amplitude_mm" + element, amplitude_mm[axis], -100.0, 100.0);
    requireInRange("motion/amplitude_deg" + element, amplitude_deg[axis], -30.0, 30.0);
  }
  requireInRange("motion/period", period, 1.0, 1e6);
  requireInRange("motion/start", start, 1, 1e6);
  requireInRange("motion/max_shift_mm", max_shift_mm, 0.0, 100.0);
  requireInRange("motion/max_rotation_deg", max_rotation_deg, 0.0, 30.0);
  requireInRange("motion/rest_share", rest_share, 0.0, 1.0);
  requireInRange("motion/rest_jitter_mm", rest_jitter_mm, 0.0, 10.0);
  requireOption(type != MotionType::CSV || !csv_file.empty(), "motion/csv_file", "empty",
                "the path of a table of poses");
}

SimulatedMotion::SimulatedMotion(const MotionOptions& options, const RigidTransform& room_from_patient,
                                 const Eigen::Vector3d& target_centre, std::uint64_t seed)
  : options_(options),
    room_from_patient_(room_from_patient),
    room_centre_(room_from_patient * target_centre),
    walk_(RandomStream(seed).part(kMotionPart).part(0)),
    jitter_(RandomStream(seed).part(kMotionPart).part(1))
{
  options.validate();
  if (options.type == MotionType::CSV)
  {
    csv_poses_ = readPoses(options.csv_file, room_from_patient);
  }
}

double SimulatedMotion::profile(int exposure, int axis) const
{
  const double phase = exposure / options_.period;
  switch (options_.type)
  {
    case MotionType::DRIFT:
      return ease(phase);
    case MotionType::STEP:
      return exposure >= options_.start ? 1.0 : 0.0;
    case MotionType::BREATHING:
      return square(std::sin(EIGEN_PI * phase));
    case MotionType::SWALLOW:
    {
      const double since_start = (exposure - options_.start) / options_.period;
      return since_start > 0.0 && since_start < 1.0 ? square(std::sin(EIGEN_PI * since_start)) : 0.0;
    }
    case MotionType::RANDOM_WALK:
      return randomWalk(walk_.part(static_cast<std::uint64_t>(axis)), exposure, options_.period);
    case MotionType::DRIFT_AND_BREATHING:
    {
      // Breaths in a drift; they do not divide it evenly, so that the axes do not come back together.
      constexpr std::array<double, 6> kBreaths = { 3.2, 2.3, 4.1, 2.7, 3.7, 1.9 };
      return 0.75 * ease(phase) + 0.25 * std::sin(2.0 * EIGEN_PI * kBreaths[axis] * phase);
    }
    case MotionType::NONE:
    case MotionType::CSV:
      break;
  }
  return 0.0;
}

Twist SimulatedMotion::targetTwist(int exposure) const
{
  Eigen::Vector3d shift;
  Eigen::Vector3d rotation;
  for (int axis = 0; axis < 3; ++axis)
  {
    shift[axis] = options_.amplitude_mm[axis] * profile(exposure, axis);
    rotation[axis] = radians(options_.amplitude_deg[axis]) * profile(exposure, axis + 3);
  }
  Twist twist;
  twist << bounded(rotation, radians(options_.max_rotation_deg)), bounded(shift, options_.max_shift_mm);
  return twist;
}

BodyPoses SimulatedMotion::poses(int exposure) const
{
  if (exposure <= 0)
  {
    return { room_from_patient_, room_from_patient_ };
  }
  BodyPoses poses;
  Twist twist;
  if (csv_poses_.empty())
  {
    twist = targetTwist(exposure);
    poses.room_from_target = motionAbout(room_centre_, twist) * room_from_patient_;
  }
  else
  {
    poses.room_from_target =
        csv_poses_[std::min<std::size_t>(static_cast<std::size_t>(exposure), csv_poses_.size() - 1)];
    twist = twistAbout(room_centre_, poses.room_from_target * room_from_patient_.inverse());
  }
  std::array<float, 3> jitter;
  jitter_.part(static_cast<std::uint64_t>(exposure)).fillNormal(jitter.data(), static_cast<int>(jitter.size()));
  Twist rest = options_.rest_share * twist;
  rest.tail<3>() += options_.rest_jitter_mm * Eigen::Map<const Eigen::Vector3f>(jitter.data()).cast<double>();
  poses.room_from_rest = motionAbout(room_centre_, rest) * room_from_patient_;
  return poses;
}
}  // namespace xray_tracking
