#pragma once

#include <string>

#include <itkImageIOBase.h>

namespace xray_tracking
{
// What ITK's readers let pass without a word, or worse. All throw std::runtime_error naming the file and what is wrong.

/// Before ITK reads the header: numbers that are not finite, at which ITK ends the process or takes others instead; axes
/// that are not given; other units than mm.
void requireUsableNiftiHeader(const std::string& path);

/// NRRD and MetaImage: voxel sizes that the header does not give, or not in mm.
void requireMillimetres(const itk::ImageIOBase& format, const std::string& path);

/// Data that end early, for whose rest ITK takes what it likes. The header must have been read.
void requireAllVoxels(const itk::ImageIOBase& format, const std::string& path);
}  // namespace xray_tracking
