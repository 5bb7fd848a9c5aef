#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_core/plan/structure_choice.h"
#include "xray_tracking_core/volume/ct_content.h"

namespace xray_tracking
{
/// What a pixel value means (docs/own_data.md, `intensity`).
struct IntensityModel
{
  enum class Kind
  {
    COUNTS,      ///< detector counts, dark bone
    ATTENUATION  ///< line integrals, bright bone
  };

  Kind kind = Kind::COUNTS;
  double offset = 0.0;               ///< counts without any exposure
  std::optional<double> air_counts;  ///< counts behind air alone, offset included; absent: estimated from the image
};

/// What is known of a treatment before the first exposure: a sequence.yaml without its frames (docs/own_data.md).
struct TreatmentSetup
{
  std::string ct_path;                           ///< absolute; empty if none is named
  CtContent ct_content = CtContent::RECOGNISED;  ///< `ct_content`
  CtChoice ct_choice;                            ///< `ct_series`, `ct_nifti_form`
  IntensityModel intensity;
  std::vector<ProjectionGeometry> detectors;                      ///< two or more, names unique
  RigidTransform room_from_patient = RigidTransform::Identity();  ///< `initial_pose`
  Eigen::AlignedBox3d target_box;                                 ///< patient frame [mm]
  std::optional<StructureChoice> target_structure;                ///< `target`, which the box is of, where it is named
  std::map<std::string, cv::Rect> regions;  ///< ROI [px] in the first exposure by detector; may lack any

  /// @throws std::invalid_argument naming the detector and those there are
  const ProjectionGeometry& detector(const std::string& name) const;
  Eigen::Vector3d targetCentre() const { return target_box.center(); }
};

/// Reads the `detectors` list of a YAML file. @throws std::runtime_error naming file, key, value and what was expected
std::vector<ProjectionGeometry> loadDetectors(const std::string& path);

/// Reads a setup file: `detectors` (a list, or the path of a YAML file that has one), `initial_pose`, `target_box_mm`
/// or `target` (`rtstruct`, the path of a DICOM RT structure set, and `roi`, the name of its structure whose box it is;
/// drawn on `ct`, a DICOM series), and optionally `ct`, `ct_content` (recognised, full, bone_in_air or labels),
/// `ct_series` and `ct_nifti_form` (qform or sform) where CtChoice is needed, `intensity`, `regions`; relative paths
/// start at the file. Keys that it does not use are left alone. Regions must lie inside their detector's image,
/// air_counts above offset, the box's min below its max, and equal to that of `target` where there are both.
/// @throws std::runtime_error naming file, key, value and what was expected
TreatmentSetup loadTreatmentSetup(const std::string& path);

/// The same from text. @param name what stands for the file in messages, and where relative paths start
TreatmentSetup treatmentSetupFromText(const std::string& text, const std::string& name);

/// A setup file's text that says the same wherever it stands, for treatmentSetupFromText(): the CT's path is absolute,
/// the detectors' are in it, and the box in the place of `target`. Numbers stand there digit by digit as in the file. A
/// block of keys, one a line, without the tables that it may name, and without `distortion`: what a graph takes and a
/// bag holds is undistorted.
/// @throws std::runtime_error as loadTreatmentSetup()
std::string selfContainedSetup(const std::string& path);

/// Writes a setup that loadTreatmentSetup reads back. @throws std::runtime_error
void saveTreatmentSetup(const TreatmentSetup& setup, const std::string& path);

/// Writes a setup or sequence.yaml anew with another initial pose. All other keys stay, and the files that they name.
/// @throws std::runtime_error naming the file that cannot be read or written
void saveWithInitialPose(const std::string& path, const RigidTransform& room_from_patient, const std::string& new_path);

/// The box around the target's eight projected corners, clipped to the image; empty if none of it is seen.
cv::Rect projectedTargetRegion(const TreatmentSetup& setup, const ProjectionGeometry& geometry);
}  // namespace xray_tracking
