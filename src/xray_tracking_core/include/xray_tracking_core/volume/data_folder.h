#pragma once

#include <string>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Where a path that comes from elsewhere than from who started a node may lead, unless somebody names another folder:
/// the folder that the setup's CT is in, or the setup file where it names none. The root of all files is no such
/// folder:
/// @throws std::runtime_error naming the CT or setup file that is in it, or is not there
std::string usualDataFolder(const TreatmentSetup& setup, const std::string& setup_file);

/// Of a CT that somebody asks for, the path without links. A relative one starts at the folder.
/// @throws std::runtime_error naming path and folder if the CT, or any file that reading it would open (slices, a
/// header's voxels), is not below the folder once all links are followed; or the path if it is not there
std::string ctBelow(const std::string& path, const std::string& folder);
}  // namespace xray_tracking
