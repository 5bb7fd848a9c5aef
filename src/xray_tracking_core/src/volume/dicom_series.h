#pragma once

#include <string>
#include <vector>

#include "stored_volume.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Reads the one CT volume of a folder and its sub-folders, or of one file (enhanced multi-frame CT); if there are
/// several, the one that `series` chooses. Scouts, screenshots, other modalities and other files are passed over.
/// Slices are put in order along their normal; a gantry tilt comes out as a sheared grid.
/// @throws std::runtime_error as readCtVolume, with a list of what is there if that has to be chosen
StoredVolume readDicomCt(const std::string& path, const std::string& series);
}  // namespace xray_tracking
