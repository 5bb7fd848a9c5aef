#pragma once

#include <string>

namespace xray_tracking
{
/// GDCM only warns of pixels that are missing at a DICOM file's end and makes them up. Compressed ones are left to
/// their decoder, which refuses them.
/// @throws std::runtime_error naming the file if it holds no pixels or fewer than its header says
void requireAllDicomPixels(const std::string& file);
}  // namespace xray_tracking
