#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_core/volume/body_model.h"

namespace xray_tracking
{
/// Where else along the patient's long axis the CT looks like the target, as the next vertebra does: the places where
/// the correlation of the box's voxels with those there has a maximum of its own, the nearest one to either side.
/// @param target_box patient frame [mm]
/// @return shifts from the target, patient frame [mm]; none where nothing repeats itself, as in a limb
std::vector<Eigen::Vector3d> lookAlikes(const BodyModel& bodies, const Eigen::AlignedBox3d& target_box);
}  // namespace xray_tracking
