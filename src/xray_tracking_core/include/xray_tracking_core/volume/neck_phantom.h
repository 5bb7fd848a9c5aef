#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/solid.h"

namespace xray_tracking
{
/// How a CT scanner samples the phantom.
struct PhantomCtOptions
{
  Eigen::Vector3i size{ 200, 200, 160 };      ///< voxels
  Eigen::Vector3d spacing{ 1.0, 1.0, 1.25 };  ///< in-plane and slice distance [mm]
  double slice_thickness = 1.25;              ///< box profile along z [mm]
  double noise_hu = 20.0;                     ///< standard deviation of white noise [HU]
  std::uint32_t seed = 1;

  /// @throws std::invalid_argument naming the option
  void validate() const;
};

/// A neck of closed-form solids in the patient frame (LPS mm, origin in the middle of C4's body): seven cervical
/// vertebrae with discs, skull base, jaw, airway, soft tissue. Not symmetric. Material amounts of overlapping solids
/// add up, so line integrals and samples follow from the same definition without voxels.
///
/// Two bodies: the target (C3 to C5 with the discs between them, C4 being the vertebra to treat) and the rest. They
/// share the patient frame at rest and may be given poses of their own.
class NeckPhantom
{
public:
  NeckPhantom();

  const std::vector<Solid>& targetSolids() const { return target_; }
  const std::vector<Solid>& restSolids() const { return rest_; }
  /// Box around C4, patient frame [mm]: the volume V of the TRE.
  const Eigen::AlignedBox3d& targetBox() const { return target_box_; }

  /// Exact material lengths [mm] along one ray given in the patient frame, both bodies at rest.
  Materials lineIntegral(const Ray& ray) const;

  /// Exact material lengths of every pixel's ray, on all cores.
  /// @param room_from_target, room_from_rest poses of the two bodies (each maps the patient frame to the room)
  /// @param soft, bone out, CV_32FC1, rows x columns, [mm]
  void lineIntegrals(const ProjectionGeometry& geometry, const RigidTransform& room_from_target,
                     const RigidTransform& room_from_rest, cv::Mat& soft, cv::Mat& bone) const;

  /// Materials in a point of the patient frame, both bodies at rest.
  Materials at(const Eigen::Vector3d& point) const;

  /// A CT of the phantom at rest, its grid centred on the origin: partial volume by averaging over each voxel (slice
  /// thickness along z), then noise. On all cores; the same for the same options.
  CtVolume sampleCt(const PhantomCtOptions& options) const;

private:
  std::vector<Solid> target_;
  std::vector<Solid> rest_;
  Eigen::AlignedBox3d target_box_;
};
}  // namespace xray_tracking
