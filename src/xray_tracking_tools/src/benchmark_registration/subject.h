#pragma once

#include <random>
#include <string>

#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_tools/exposure_set.h"

namespace xray_tracking
{
/// What is registered, and where it really is.
struct Subject
{
  std::string name;
  PatientCt ct;
  ExposureSet exposures;

  const Eigen::AlignedBox3d& box() const { return exposures.setup.target_box; }
  RigidTransform moved(const Twist& twist, const RigidTransform& pose) const
  {
    return motionAbout(pose * box().center(), twist) * pose;
  }
};

/// A sequence folder with its CT. @throws std::invalid_argument without a CT or a gold standard
Subject sequenceSubject(const std::string& path);

/// Which vertebra of the phantom is registered, how it was scanned and how the rest moves.
struct PhantomCase
{
  std::string target = "c4";
  std::string room = "cyberknife";
  double voxel = 1.0;  ///< [mm]
  double rest_mm = 4.0;
  double rest_degrees = 2.0;
};

/// Box around a vertebra of the phantom, c3 to c6, patient frame [mm]. @throws std::invalid_argument
Eigen::AlignedBox3d phantomBox(const std::string& vertebra);

/// A CT of the phantom: voxels of this edge in plane, slices of this thickness and distance [mm].
CtVolume phantomCt(double voxel, double slice);

/// Closed-form X-rays of the phantom with the simulator's physics, of a CT of it: the target anywhere up to 12 mm and 4
/// degrees, the rest of the body somewhere else. C3 to C5 move as one, C6 with the phantom's rest.
Subject phantomSubject(int count, const PhantomCase& what);
}  // namespace xray_tracking
