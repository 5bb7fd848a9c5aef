#pragma once

#include <memory>

#include <Eigen/Geometry>

#include "ct_ends.h"
#include "xray_tracking_core/volume/body_model.h"
#include "xray_tracking_registration/body_renderer.h"

namespace xray_tracking
{
/// What is rendered: the target and the rest of the body. Also one body has two parts, which then have one pose: so it
/// can be asked whether they would rather have one each.
struct Bodies
{
  /// @param target_box patient frame [mm]
  /// @param footprint as BodyRenderer takes it
  /// @throws std::invalid_argument if there is no voxel; std::runtime_error if one body has none in the box
  Bodies(const BodyModel& model, const Eigen::AlignedBox3d& target_box, double footprint, Projector projector);

  std::unique_ptr<const BodyRenderer> target;
  std::unique_ptr<const BodyRenderer> rest;
  Eigen::Vector3d centre;   ///< of the target, patient frame [mm]
  bool one;                 ///< poses are the same
  bool surrounded = false;  ///< one body, with more of the CT around the target than next to nothing
  CtEnds target_ends;
  CtEnds rest_ends;
};
}  // namespace xray_tracking
