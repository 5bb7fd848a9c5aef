#pragma once

#include <memory>

#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/target_mask.h"
#include "xray_tracking_detector_simulator/anatomy.h"

namespace xray_tracking
{
/// A CT whose target moves rigidly and whose rest moves otherwise, with all between them deforming continuously by the
/// mask's weight, and waves of a wavelength of 150 mm through the rest. X-rays are samples along every ray, each split
/// into soft tissue and bone: no code is shared with the renderers that a registration uses.
class DeformingCt : public Anatomy
{
public:
  /// @param target share of every point, 0 to 1, that moves with the target; on any grid
  /// @param wave_mm amplitude of the waves; @param step of the samples [mm]
  DeformingCt(std::shared_ptr<const CtVolume> ct, TargetMask target, double wave_mm, double step);

  void materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                 cv::Mat& bone) const override;

private:
  Materials along(const Ray& ray, const BodyPoses& poses) const;

  std::shared_ptr<const CtVolume> ct_;
  TargetMask target_;
  Eigen::Affine3d index_from_patient_;
  Eigen::Affine3d mask_from_patient_;
  double wave_mm_;
  double step_;
};

/// The CT sampled on other voxels, of this edge in plane and slices of this thickness [mm], as far as `region` (patient
/// frame) reaches: averages over each voxel.
CtVolume resampled(const CtVolume& ct, double voxel, double slice, const Eigen::AlignedBox3d& region);
}  // namespace xray_tracking
