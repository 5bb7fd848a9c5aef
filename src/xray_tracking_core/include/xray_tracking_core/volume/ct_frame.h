#pragma once

#include <string>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Where a DICOM CT lies: what plans and structures drawn on it share with it.
struct CtFrame
{
  std::string path;
  VolumeGrid grid;
  std::string frame_of_reference;  ///< FrameOfReferenceUID (0020,0052)
};

/// Of the headers of a DICOM CT alone. @param series as of CtChoice
/// @throws std::runtime_error as readCtVolume(); naming the path if it is no DICOM, or its slices have no frame of
/// reference or several
CtFrame readCtFrame(const std::string& path, const std::string& series = "");
}  // namespace xray_tracking
