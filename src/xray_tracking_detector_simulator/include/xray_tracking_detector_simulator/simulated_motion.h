#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_detector_simulator/body_poses.h"
#include "xray_tracking_detector_simulator/random_stream.h"

namespace xray_tracking
{
enum class MotionType
{
  NONE,
  DRIFT,                ///< eases to the amplitude within `period` exposures and stays there
  STEP,                 ///< jumps to the amplitude at exposure `start`
  BREATHING,            ///< to the amplitude and back in every `period` exposures
  SWALLOW,              ///< to the amplitude and back once, `period` exposures long, from exposure `start` on
  RANDOM_WALK,          ///< wanders at random about as far as the amplitude, at its slowest in `period` exposures
  DRIFT_AND_BREATHING,  ///< a drift of `period` exposures with breathing on it, every axis at its own pace
  CSV                   ///< the poses of a file
};

/// @param name in lower case, e.g. "random_walk". @throws std::invalid_argument naming `motion/type` and all types
MotionType motionTypeFromName(const std::string& name);

/// How the target moves, and the rest of the body with it. Times count in exposures, so that a run is the same at any
/// rate.
struct MotionOptions
{
  MotionType type = MotionType::DRIFT_AND_BREATHING;
  Eigen::Vector3d amplitude_mm{ -7.0, 5.0, 6.0 };           ///< shift along room x, y, z, -100 to 100 [mm]
  Eigen::Vector3d amplitude_deg = Eigen::Vector3d::Zero();  ///< rotation vector, room axes, -30 to 30 [deg]
  double period = 29.0;                                     ///< see MotionType, 1 to 1e6 [exposures]
  int start = 10;                                           ///< see MotionType, 1 to 1e6 [exposures]
  double max_shift_mm = 12.0;                               ///< bound of the shift's length, 0 to 100 [mm]
  double max_rotation_deg = 3.0;                            ///< bound of the rotation's angle, 0 to 30 [deg]
  std::string csv_file;                                     ///< for CSV
  double rest_share = 0.9;                                  ///< the rest's motion over the target's, 0 to 1
  double rest_jitter_mm = 0.4;  ///< of the rest's shift, every axis and exposure, standard deviation, 0 to 10 [mm]

  /// @throws std::invalid_argument naming the key (`motion/...`), its value and the range
  void validate() const;
};

/// The poses of target and rest in every exposure. Motions since exposure 0 are twists about the target's centre in
/// room axes (motionAbout); bounded smoothly: |shift| < max_shift_mm, angle < max_rotation_deg. In exposure 0 both
/// bodies have exactly the given pose. A pose depends on (options, seed, exposure) alone.
class SimulatedMotion
{
public:
  /// @param room_from_patient pose at exposure 0; @param target_centre patient frame [mm]
  /// @throws std::invalid_argument as MotionOptions::validate; std::runtime_error naming the CSV file and the line. The
  /// file is a sequence folder's gold_standard.csv: absolute room_T_patient, one row an exposure, stamps growing, the
  /// first row equal to `room_from_patient` (to 0.01 mm and 0.01 degrees). Its poses are used as they are, without the
  /// bounds; beyond its end the last one stays.
  SimulatedMotion(const MotionOptions& options, const RigidTransform& room_from_patient,
                  const Eigen::Vector3d& target_centre, std::uint64_t seed);

  /// @param exposure index, from 0
  BodyPoses poses(int exposure) const;

private:
  double profile(int exposure, int axis) const;
  Twist targetTwist(int exposure) const;

  MotionOptions options_;
  RigidTransform room_from_patient_;
  Eigen::Vector3d room_centre_;
  RandomStream walk_;
  RandomStream jitter_;
  std::vector<RigidTransform> csv_poses_;
};
}  // namespace xray_tracking
