#pragma once

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_motion_estimation/region_patch.h"

namespace xray_tracking
{
/// How the bone (HU over 200) in the setup's target box is spread: of its CT, or of the neck phantom if it names none.
/// @throws std::runtime_error as readPatientCt(), or naming a box without bone
TargetShape boneShape(const TreatmentSetup& setup);
}  // namespace xray_tracking
