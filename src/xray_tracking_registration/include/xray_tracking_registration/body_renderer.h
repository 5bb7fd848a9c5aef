#pragma once

#include <memory>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/projection/attenuation_field.h"
#include "xray_tracking_core/projection/pixel_grid.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// One body at several resolutions; line integrals come from the one that suits the pixels.
class BodyRenderer
{
public:
  /// @param volume attenuation [1/mm]; moved in, as it is held twice for a while
  /// @param footprint edge of the smallest bins that will be asked for, at the volume [mm]: the finest resolution has
  ///        their blur in place of that of voxels and interpolation; coarser ones are halved, as long as their bins can
  ///        be
  /// @param projector what render() uses
  /// @param smoothness finest voxel edge that will do, in grid steps at the volume
  BodyRenderer(ScalarVolume volume, double footprint, double smoothness, Projector projector);

  /// Line integrals at the grid's points and their derivatives by the twist of motionAbout(centre, twist) *
  /// room_from_body at zero, from the coarsest volume whose finest voxel edge is not above `smoothness` grid steps at
  /// `centre`.
  /// @param line_integrals out, CV_32FC1; @param derivatives out, CV_32FC(6) [1 / rad, 1 / mm]
  void renderWithDerivatives(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                             const RigidTransform& room_from_body, const Eigen::Vector3d& centre,
                             cv::Mat& line_integrals, cv::Mat& derivatives) const;
  /// Line integrals alone.
  void render(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& room_from_body,
              const Eigen::Vector3d& centre, cv::Mat& line_integrals) const;

  /// Bytes held.
  std::size_t memory() const;
  AttenuationField::Statistics fieldStatistics() const;

private:
  struct Level
  {
    double edge;  ///< finest voxel edge [mm]
    std::unique_ptr<const ShearWarpRenderer> renderer;
    std::shared_ptr<const ScalarVolume> volume;     ///< for ray casting alone
    std::unique_ptr<const AttenuationField> field;  ///< for attenuation fields alone
  };

  const Level& suiting(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                       const Eigen::Vector3d& centre) const;

  double smoothness_;
  std::vector<Level> levels_;  ///< fine to coarse
};
}  // namespace xray_tracking
