#pragma once

#include <string>
#include <vector>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// The slices of a CT series and the grid that they make up.
struct DicomSeries
{
  std::vector<std::string> files;  ///< one a slice, k growing
  VolumeGrid grid;
};

/// Finds the one CT series in a folder by its files' headers, sorted along the slices' normal. Other kinds of files are
/// passed over. A gantry tilt comes out as a sheared grid.
/// @throws std::runtime_error naming the folder and what is wrong: no CT, more than one CT series, a slice missing or
/// twice there, slices that differ in size, spacing or orientation
DicomSeries findCtSeries(const std::string& folder);
}  // namespace xray_tracking
