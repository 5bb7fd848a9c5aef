#pragma once

#include <optional>
#include <string>

#include "xray_tracking_core/volume/body_model.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace xray_tracking
{
/// What a CT holds of what the X-rays see.
enum class CtContent
{
  RECOGNISED,  ///< one of the others, by recognisedContent()
  FULL,        ///< the patient, or a part cut out of one: bone, soft tissue, air
  BONE_IN_AIR  ///< segmented bones or implants on a constant background: the X-rays also see what is around them
};

/// `recognised`, `full`, `bone_in_air`. @throws std::invalid_argument with these
CtContent ctContentNamed(const std::string& name);
std::string nameOf(CtContent content);

/// BONE_IN_AIR if most of what is met within the first 2 mm on the way out of air or of the background, the value that
/// at least a third of all voxels have, is bone; else FULL: a patient's surface, lungs and sinuses are mostly covered
/// by soft tissue.
CtContent recognisedContent(const CtVolume& ct);

/// What each voxel adds to water, as HU of a body in air: HU - 1000, at least -1000. Where only bone is known, this is
/// what X-rays through the whole patient show of it: around it is water, whose surface is smooth and elsewhere.
CtVolume addedToWater(CtVolume ct);

/// The bodies of a CT for registration: split by the mask, or one if there is none or next to nothing outside of it (2
/// % of the target's attenuation); of BONE_IN_AIR what it adds to water.
/// @throws as splitBodies()
BodyModel bodiesOf(const CtVolume& ct, const std::optional<TargetMask>& mask, CtContent content);
}  // namespace xray_tracking
