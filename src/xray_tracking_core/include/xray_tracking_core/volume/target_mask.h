#pragma once

#include <string>

#include <Eigen/Geometry>

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// How the part of a CT that moves with the target is told from the rest.
struct TargetMaskOptions
{
  double threshold_hu = 180.0;  ///< bone from here on, -1000 to 3000 [HU]
  double closing_mm = 2.0;      ///< radius of the closing that fills marrow and joins what is one bone, 0 to 10 [mm]
  double inner_mm = 3.0;        ///< weight 1 up to this distance from the bone, 0 to 50 [mm]
  double outer_mm = 15.0;       ///< weight 0 from this distance on, above inner_mm, to 100 [mm]

  /// @throws std::invalid_argument naming the option, its value and the range
  void validate() const;
};

/// Share of every voxel, 0 to 1, that moves with the target. The grid is a part of the CT's: the box outside of which
/// all weights are 0.
using TargetMask = ScalarVolume;

/// From the CT's bone inside the box: threshold, closing, largest connected component, then a weight that falls
/// smoothly (cubic) with the distance from it. Bone is cut where it leaves the box.
/// @param target_box patient frame [mm]
/// @throws std::invalid_argument as validate(); std::runtime_error naming the box if it holds no bone of the CT
TargetMask targetMaskFromBone(const CtVolume& ct, const Eigen::AlignedBox3d& target_box,
                              const TargetMaskOptions& options = {});

/// The same from a CT of labels: of the label that most voxels in the box have. The threshold does not count.
/// @throws std::invalid_argument as validate(); std::runtime_error naming the box if it holds no label
TargetMask targetMaskFromLabels(const CtVolume& labels, const Eigen::AlignedBox3d& target_box,
                                const TargetMaskOptions& options = {});

/// The same from a label map on the CT's grid: its voxels of the given value, in no box.
/// @throws std::runtime_error if the label does not occur, or the label map's grid is not the CT's
TargetMask targetMaskFromLabels(const VolumeGrid& ct_grid, const CtVolume& labels, int label,
                                const TargetMaskOptions& options = {});

/// The same from the box alone: weight 1 in it and up to inner_mm around.
/// @throws std::runtime_error naming the box if it holds no voxel
TargetMask targetMaskFromBox(const VolumeGrid& ct_grid, const Eigen::AlignedBox3d& target_box,
                             const TargetMaskOptions& options = {});

/// Writes the weights in thousandths as a volume file, in the CT's place, for any viewer. @throws as writeCtVolume
void writeTargetMask(const TargetMask& mask, const std::string& path);
}  // namespace xray_tracking
