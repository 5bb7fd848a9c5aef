#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// What a volume's file or folder holds, of which it is not known yet whether it is HU or labels.
struct StoredVolume
{
  CtVolume volume;                ///< values rounded to whole numbers
  std::optional<float> fraction;  ///< a value that was not whole, if there is one
};

/// More than the largest CT has: 2 GB as they are held. A header may claim any number.
constexpr std::size_t kMostVoxels = std::size_t(1) << 30;

/// @throws as readCtVolume, but for what values may be
StoredVolume readStoredVolume(const std::string& path, const CtChoice& choice);

/// Adds values, rounded to whole numbers. @param path for messages
void appendRounded(const float* values, std::size_t count, const std::string& path, StoredVolume& stored);

/// @throws std::runtime_error naming the path if the grid has no three axes, more than kMostVoxels, or is not of a
/// patient in mm
void requireUsableGrid(const VolumeGrid& grid, const std::string& path);

/// Why the values are no HU of a body in air; empty if they may be.
std::string whyNotHu(const CtVolume& volume);

/// Why the values are no labels; empty if they may be: whole numbers, 0 for the background, few others above it.
std::string whyNotLabels(const StoredVolume& stored);

/// Whether a voxel's neighbours mostly have its value, as in a label map; grey values differ from voxel to voxel.
bool isPatchwork(const CtVolume& volume);
}  // namespace xray_tracking
