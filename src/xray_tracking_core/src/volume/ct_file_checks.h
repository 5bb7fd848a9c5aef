#pragma once

#include <string>

#include <itkImageIOBase.h>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
// What ITK's readers of NRRD and MetaImage let pass without a word, or get wrong. All throw std::runtime_error naming
// the file and what is wrong.

/// Before ITK reads the header: axes that are not given, or not of a patient; voxel sizes that are not given or not in
/// mm; values that would have to be rescaled.
void requireUsableTextHeader(const itk::ImageIOBase& format, const std::string& path);

/// Data that end early, for whose rest ITK takes what it likes. The header must have been read.
void requireAllVoxels(const itk::ImageIOBase& format, const std::string& path);

/// The grid in LPS. The header must have been read. NRRD's axes are taken from the header itself: ITK turns those of
/// left-anterior-superior the wrong way.
VolumeGrid gridOf(const itk::ImageIOBase& format, const std::string& path);
}  // namespace xray_tracking
