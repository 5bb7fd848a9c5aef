#pragma once

#include <optional>
#include <set>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
/// What files of other programs leave open. docs/geometry.md has the rules.
struct GeometryImportOptions
{
  std::optional<Eigen::Vector2i> image_size;   ///< columns, rows [px]: of matrices and RTK; instead of a MayaCam's
  std::optional<Eigen::Vector2d> pixel_pitch;  ///< along columns, along rows [mm], where the file has none
  std::optional<double> source_to_detector;    ///< SDD [mm], instead of the pitch
  /// Of the coordinates in MayaCam, matrix and RTK files [mm]; absent: 1, which distances must bear out.
  std::optional<double> unit;
  /// A room point that all views see [mm]; absent: the one nearest to the rays through their images' middles.
  std::optional<Eigen::Vector3d> point;
  std::vector<int> projections;    ///< of an RTK file, from 0
  std::vector<std::string> names;  ///< of the detectors; absent: the file's
  /// Where the file has none either, if these are as many as the views; else detector_a, detector_b ...
  std::vector<std::string> default_names;
  std::set<std::string> flip_rows;     ///< detectors whose images were turned upside down after the file was written
  std::set<std::string> flip_columns;  ///< the same, left to right
};

/// As a setup's `distortion` has it (LensDistortion); none if there is no model.
struct DistortionCoefficients
{
  std::string model;
  std::vector<double> values;
};

struct ImportedGeometry
{
  std::vector<ProjectionGeometry> detectors;
  std::vector<DistortionCoefficients> distortions;  ///< one for each
  std::vector<std::string> remarks;                 ///< what was found and chosen, a line for each detector or more
  /// A room point that all views see [mm]; nothing if none is known.
  std::optional<Eigen::Vector3d> point;
};

/// What no X-ray room has, in words with what may be the reason: a source that is less than 200 mm or more than 10 m
/// from the patient, a panel that is nearer or beyond 15 m, a panel smaller than 10 mm or larger than 2 m. Empty if
/// there is nothing of it.
/// @param patient a room point of his [mm]
std::string implausibility(const ProjectionGeometry& detector, const Eigen::Vector3d& patient);
/// The same of the panel alone, where no point of the patient is known.
std::string implausibility(const ProjectionGeometry& detector);

/// Reads detectors from what other programs write, one or more files of one form, which is recognised: MayaCam 2.0, 3 x
/// 4 projection matrices as text, RTK's ThreeDCircularProjectionGeometry, DICOM X-ray and RT images, or a YAML file
/// with `detectors`. The coordinates of the room are those of the file; DICOM, which has angles, comes out in
/// treatment_room as docs/frames.md has it.
/// @throws std::runtime_error or std::invalid_argument naming file, line or key, value and what was expected: what
/// cannot be read; what ProjectionGeometry cannot be (left-handed, with the flip that mends it; skewed by more than
/// half a pixel; with lens distortion); fewer than two views, views from one place; distances that no room has (metres,
/// centimetres, source and panel swapped)
ImportedGeometry importGeometry(const std::vector<std::string>& files, const GeometryImportOptions& options);

/// Writes the detectors as a YAML file.
/// @param into path of a setup or sequence.yaml whose other keys are kept, empty for none; the paths in it are made
/// absolute if `path` is in another folder
/// @throws std::runtime_error
void writeDetectors(const ImportedGeometry& geometry, const std::string& path, const std::string& into);
}  // namespace xray_tracking
