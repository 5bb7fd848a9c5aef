#pragma once

#include <string>

namespace xray_tracking
{
/// Which structure: of a setup's `target`.
struct StructureChoice
{
  std::string file;  ///< absolute path of a DICOM RT structure set
  std::string roi;   ///< its ROIName
};
}  // namespace xray_tracking
