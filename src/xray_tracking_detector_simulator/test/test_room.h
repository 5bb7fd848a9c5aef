#pragma once

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// A panel of 204.8 mm, as far away as a CyberKnife's, with 128 x 128 pixels; the source at `angle` [rad] about room x.
inline ProjectionGeometry makeDetector(const std::string& name, double angle)
{
  constexpr double kPitch = 1.6;
  const Eigen::Vector3d to_source(0.0, std::sin(angle), std::cos(angle));
  DetectorDescription description;
  description.name = name;
  description.image_size = { 128, 128 };
  description.pixel_pitch = { kPitch, kPitch };
  description.x_direction = Eigen::Vector3d::UnitX();
  description.y_direction = -to_source.cross(description.x_direction);
  description.source = 2600.0 * to_source;
  description.origin = -1200.0 * to_source - 63.5 * kPitch * (description.x_direction + description.y_direction);
  return ProjectionGeometry::fromDescription(description);
}

/// The neck phantom, supine in the isocentre, in front of two such panels at right angles.
inline TreatmentSetup makeSetup()
{
  TreatmentSetup setup;
  setup.intensity.offset = 100.0;
  setup.intensity.air_counts = 60000.0;
  setup.detectors = { makeDetector("detector_a", EIGEN_PI / 4), makeDetector("detector_b", -EIGEN_PI / 4) };
  setup.room_from_patient =
      makeRigidTransform(Eigen::Vector3d(1.0, -2.0, 3.0), Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5));
  setup.target_box = { Eigen::Vector3d(-28.0, -22.0, -12.0), Eigen::Vector3d(28.0, 50.0, 12.0) };
  return setup;
}

/// Expects an exception whose text has `part` in it.
template <typename Exception, typename Function>
void expectThrowNaming(const std::string& part, const Function& function)
{
  try
  {
    function();
    ADD_FAILURE() << "nothing was thrown, expected an error about " << part;
  }
  catch (const Exception& error)
  {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
  }
}
}  // namespace xray_tracking
