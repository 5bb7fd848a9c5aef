#include "xray_tracking_registration/body_renderer.h"

#include <algorithm>

#include "xray_tracking_core/volume/resampling.h"

namespace xray_tracking
{
BodyRenderer::BodyRenderer(const ScalarVolume& volume, double footprint)
{
  const ScalarVolume half = halved(volume);
  const Eigen::Vector3d variance = Eigen::Vector3d::Constant(footprint * footprint / 12.0);
  for (const ScalarVolume& level : { filtered(volume, variance), half })
  {
    levels_.push_back({ level.grid.spacing().minCoeff(), std::make_unique<ShearWarpRenderer>(level) });
  }
}

const ShearWarpRenderer& BodyRenderer::suiting(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                                               const Eigen::Vector3d& centre) const
{
  const double step = pixels.step.cwiseProduct(geometry.pixelPitch()).minCoeff() / geometry.magnification(centre);
  const auto coarser =
      std::find_if(levels_.rbegin(), levels_.rend(), [&](const Level& level) { return level.edge <= 1.001 * step; });
  return coarser == levels_.rend() ? *levels_.front().renderer : *coarser->renderer;
}

void BodyRenderer::renderWithDerivatives(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                                         const RigidTransform& room_from_body, const Eigen::Vector3d& centre,
                                         cv::Mat& line_integrals, cv::Mat& derivatives) const
{
  suiting(geometry, pixels, centre)
      .renderWithDerivatives(geometry, pixels, room_from_body, centre, line_integrals, derivatives);
}

void BodyRenderer::render(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                          const RigidTransform& room_from_body, const Eigen::Vector3d& centre,
                          cv::Mat& line_integrals) const
{
  suiting(geometry, pixels, centre).render(geometry, pixels, room_from_body, line_integrals);
}

std::size_t BodyRenderer::memory() const
{
  std::size_t bytes = 0;
  for (const Level& level : levels_)
  {
    bytes += level.renderer->memory();
  }
  return bytes;
}
}  // namespace xray_tracking
