#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
using ProjectionMatrix = Eigen::Matrix<double, 3, 4>;

/// A view as a file has it: not yet known to be one that ProjectionGeometry can be.
struct ImportedView
{
  std::string where;           ///< file and what of it, for messages
  std::string name;            ///< of the detector; empty if the file has none
  Eigen::Vector2i image_size;  ///< columns, rows [px]
  ProjectionMatrix matrix;     ///< room [mm] to pixels; of any scale
  /// The third row is positive in front of the source; else only the scene tells.
  bool front_is_known = false;
  bool is_in_mm = false;                       ///< by the definition of the form
  std::optional<Eigen::Vector2d> pixel_pitch;  ///< [mm], if the file has it
  DistortionCoefficients distortion;
  std::string flip;  ///< "rows" or "columns": what mends a left-handed panel of this form
  std::string hint;  ///< what else may be wrong if the panel is left-handed, or nothing fits
};

/// The tangential coefficient (p1: 2, p2: 3), if there is a distortion, where the axis that it belongs to is turned.
inline void turnTangential(DistortionCoefficients& distortion, std::size_t index)
{
  if (!distortion.model.empty())
  {
    distortion.values[index] = -distortion.values[index];
  }
}

/// The file has panel and source: its view.
/// @param description may be left-handed @throws std::runtime_error if the source is in the panel's plane
ImportedView viewOf(const DetectorDescription& description, const std::string& where);

/// Recognises a file's form and reads it. @throws as importGeometry()
std::vector<ImportedView> readViews(const std::string& path, const GeometryImportOptions& options);

std::vector<ImportedView> readMayaCam(const std::string& path, const std::string& text,
                                      const GeometryImportOptions& options);
std::vector<ImportedView> readMatrices(const std::string& path, const std::string& text,
                                       const GeometryImportOptions& options);
std::vector<ImportedView> readRtkGeometry(const std::string& path, const std::string& text,
                                          const GeometryImportOptions& options);
std::vector<ImportedView> readDicomGeometry(const std::string& path, const GeometryImportOptions& options);
std::vector<ImportedView> readDetectorList(const std::string& path, const GeometryImportOptions& options);

/// A line of a text file.
struct TextLine
{
  std::string text;   ///< without the spaces around it
  std::string where;  ///< file and number
};

/// For messages: the beginning, between quotation marks, without what cannot be printed.
std::string quoted(const std::string& text);

/// The lines that are not blank.
std::vector<TextLine> linesOf(const std::string& path, const std::string& text);

/// The numbers of a text, between spaces, commas, semicolons and brackets.
/// @throws std::runtime_error naming what is not a finite number
std::vector<double> numbersOf(const std::string& text, const std::string& where);

/// @throws std::invalid_argument naming the first option that is given, with which the form has nothing to do
void refuseOptions(const std::string& path, const std::vector<std::pair<const char*, bool>>& given);

/// Image size and pitch of forms that have none. @throws std::invalid_argument naming the option
Eigen::Vector2i imageSizeOf(const GeometryImportOptions& options, const std::string& path);
Eigen::Vector2d pixelPitchOf(const GeometryImportOptions& options, const std::string& path);
}  // namespace xray_tracking
