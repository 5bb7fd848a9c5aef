#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_core/plan/structure.h"
#include "xray_tracking_core/volume/ct_frame.h"

namespace xray_tracking
{
/// How the patient lies for a beam of a DICOM RT plan. Angles as IEC 61217 and the plan have them [degrees], all
/// right-handed about their axis: docs/geometry.md has them drawn.
struct PlanBeam
{
  int number = 0;  ///< BeamNumber
  std::string name;
  Eigen::Vector3d isocentre;     ///< patient frame (LPS) [mm]
  std::string patient_position;  ///< HFS, HFP, HFDR, HFDL, FFS, FFP, FFDR or FFDL
  double gantry_angle = 0.0;     ///< of the first control point; says nothing of the patient
  double couch_angle = 0.0;      ///< PatientSupportAngle, about the fixed system's Z
  double eccentric_angle = 0.0;  ///< TableTopEccentricAngle, about Z
  double pitch_angle = 0.0;      ///< TableTopPitchAngle, about the table top's X
  double roll_angle = 0.0;       ///< TableTopRollAngle, about the pitched table top's Y
};

struct TreatmentPlan
{
  std::string file;
  std::string frame_of_reference;           ///< FrameOfReferenceUID; old plans have none
  std::string patient_id;                   ///< for comparison alone; may be empty
  std::vector<std::string> structure_sets;  ///< SOPInstanceUID of those that it was made on
  std::vector<PlanBeam> beams;              ///< one or more
};

/// Reads a DICOM RT plan.
/// @throws std::runtime_error naming file, beam, tag, value and what was expected: no beams, no isocentre, another
/// patient position, numbers that are none, a couch or isocentre that moves during a beam
TreatmentPlan readTreatmentPlan(const std::string& path);

/// The beam of that number; without one, the first if the patient lies alike for all.
/// @throws std::runtime_error with a list of the beams
const PlanBeam& chosenBeam(const TreatmentPlan& plan, const std::optional<int>& number);

/// Where the patient is for a beam: the isocentre in the room's origin.
/// Room from IEC 61217 fixed (room x, y, z = fixed Y, -X, Z), fixed from table top, table top from patient.
RigidTransform roomFromPatient(const PlanBeam& beam);

/// @throws std::runtime_error naming both if the plan is another patient's than the structure set, of another frame of
/// reference than the CT; if it names none and was made on another structure set
void requireOn(const TreatmentPlan& plan, const Structure& structure, const CtFrame& ct);
}  // namespace xray_tracking
