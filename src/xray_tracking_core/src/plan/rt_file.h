#pragma once

#include <string>

#include "../volume/dicom_file.h"

namespace xray_tracking
{
/// Reads an RT object: `RTSTRUCT` or `RTPLAN`.
/// @throws std::runtime_error naming the file, the tag, its value and what was expected: not there, not DICOM, another
/// modality or SOP class, truncated, deflated, not as the standard has it, larger than any real one
DicomData readRtFile(const std::string& path, const std::string& modality);

/// A name for people and comparisons, as UTF-8: of Latin-1 or ASCII; of other character sets what is not ASCII as '?'.
std::string rtName(const DicomData& file, const DicomData& item, const gdcm::Tag& tag);

/// @throws std::runtime_error "FILE: WHAT"
[[noreturn]] void failRt(const std::string& path, const std::string& what);
}  // namespace xray_tracking
