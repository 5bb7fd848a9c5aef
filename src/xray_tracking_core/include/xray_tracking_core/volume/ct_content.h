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
  RECOGNISED,   ///< one of the others: LABELS by what readPatientCt() finds, else by recognisedContent()
  FULL,         ///< HU of the patient, or of a part cut out of one: bone, soft tissue, air
  BONE_IN_AIR,  ///< HU of segmented bones or implants on a constant background: the X-rays also see what is around them
  LABELS        ///< a segmentation: whole numbers, 0 for the background, others for a bone each
};

/// `recognised`, `full`, `bone_in_air`, `labels`. @throws std::invalid_argument with these
CtContent ctContentNamed(const std::string& name);
std::string nameOf(CtContent content);

/// Of HU: BONE_IN_AIR if most of what is met within the first 2 mm on the way out of air or of the background, the
/// value that at least a third of all voxels have, is bone; else FULL: a patient's surface, lungs and sinuses are
/// mostly covered by soft tissue.
CtContent recognisedContent(const CtVolume& ct);

/// A CT of which it is known what it holds.
struct PatientCt
{
  CtVolume volume;                      ///< HU, or labels
  CtContent content = CtContent::FULL;  ///< not RECOGNISED
};

/// Reads a CT of HU, or a label map, in the same formats. Which one it is is recognised, or declared. Labels are
/// recognised where at most 200 different whole numbers lie above a background of 0, and voxels' neighbours are mostly
/// alike: grey values are not.
/// @throws std::runtime_error as readCtVolume(), naming the path and what was expected where the values are no HU
///         (FULL, BONE_IN_AIR), no labels (LABELS: a fraction, as of a probability, a value below 0 or more than 200
///         above it, no background) or neither
PatientCt readPatientCt(const std::string& path, CtContent content = CtContent::RECOGNISED,
                        const CtChoice& choice = {});

/// The same of HU that are at hand already.
PatientCt recognisedCt(CtVolume hu);

/// The target of any content: targetMaskFromBone(), of LABELS targetMaskFromLabels(). @throws as these
TargetMask targetMaskOf(const PatientCt& ct, const Eigen::AlignedBox3d& target_box,
                        const TargetMaskOptions& options = {});

/// The bodies of a CT for registration: split by the mask, or one if there is none or next to nothing outside of it (2
/// % of the target's attenuation).
///
/// BONE_IN_AIR and LABELS are taken as what each voxel adds to water, HU - 1000 of a body in air, at least -1000: where
/// only bone is known, this is what X-rays through the whole patient show of it; around it is water, whose surface is
/// smooth and elsewhere. Every label is solid cortical bone (kBoneAttenuation, as HU 1592): the brightness of the whole
/// does not count, as images are normalised. A shell about something softer was no better, not even for a wrist's shaft
/// (tried on thorax_01 and wrist_real: 0.34 and 0.33 mm solid, 0.4 to 0.9 mm with shells of 1.5 to 3 mm).
/// @throws as splitBodies()
BodyModel bodiesOf(const PatientCt& ct, const std::optional<TargetMask>& mask);
}  // namespace xray_tracking
