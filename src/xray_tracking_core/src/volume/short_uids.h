#pragma once

#include <string>

namespace xray_tracking
{
/// The text with DICOM UIDs cut down to "..." and their last eight characters: enough to tell those of one folder
/// apart, and none that leads back to the patient. Messages go to logs and bags, and PACSs name files by UIDs.
std::string withShortUids(const std::string& text);
}  // namespace xray_tracking
