#pragma once

#include <cstdint>
#include <string>

namespace xray_tracking
{
/// Whether a DICOM file holds all that its elements' lengths say. GDCM ends the process by an assertion where a file
/// ends within its header, and allocates what a length asks for before it looks for the bytes.
struct DicomExtent
{
  enum class State
  {
    WHOLE,     ///< every element and item ends where the file or what it is in says
    CUT,       ///< the file ends before one does, or sequences lie deeper than any real one's
    UNSAFE,    ///< not as the standard has it, or deflated: not to be given to GDCM, which may end the process, or take
               ///< a value for a length
    NO_DICOM,  ///< not readable, or not a DICOM file by its first bytes
    IRREGULAR,  ///< WHOLE, with elements without a VR among others that have one
  };

  State state = State::WHOLE;
  bool before_pixels = false;  ///< CUT: before the pixels' own bytes
  std::string why;             ///< in words, with places; empty if WHOLE
};

/// Walks over the lengths of all elements; values are passed over.
DicomExtent dicomExtent(const std::string& path);
}  // namespace xray_tracking
