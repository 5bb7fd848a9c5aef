#pragma once

#include <string>
#include <vector>

#include "stored_volume.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// By its header, of a single file or of a pair (.hdr, .img), compressed or not; Analyze, too.
bool isNifti(const std::string& path);

/// The files of which a NIfTI is read: the one, or the pair of header and voxels.
std::vector<std::string> niftiFiles(const std::string& path);

/// Reads a NIfTI-1 volume, where qform and sform, both if there are both, must mean the same grid: ITK takes one of
/// them without a word, and brings a sheared one to right angles.
/// @throws as readCtVolume
StoredVolume readNifti(const std::string& path, NiftiForm form);
}  // namespace xray_tracking
