#pragma once

#include <string>

#include "subject.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace xray_tracking
{
/// Draws the CT's axial and sagittal slice through the target's centre, the mask's weight in red, the box in yellow.
/// @throws std::runtime_error naming the file if it cannot be written
void drawMask(const Subject& subject, const TargetMask& mask, const std::string& path);
}  // namespace xray_tracking
