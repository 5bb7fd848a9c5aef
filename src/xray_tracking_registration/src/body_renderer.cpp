#include "xray_tracking_registration/body_renderer.h"

#include <algorithm>
#include <utility>

#include <tbb/parallel_for.h>

#include "xray_tracking_core/projection/exact_projection.h"
#include "xray_tracking_core/volume/resampling.h"

namespace xray_tracking
{
namespace
{
/// Of the fields, in voxels: poses from fields and from ray casting then agree to 0.15 mm.
constexpr double kFieldStep = 0.125;
/// Of each of up to four fields.
constexpr std::size_t kFieldBytes = std::size_t{ 64 } << 20;

/// Every point's line integral by `integrate(ray)`, rays in the body's frame.
template <typename Integrate>
void castRays(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& room_from_body,
              cv::Mat& line_integrals, Integrate integrate)
{
  const RigidTransform body_from_room = room_from_body.inverse();
  line_integrals.create(pixels.size.y(), pixels.size.x(), CV_32FC1);
  tbb::parallel_for(0, line_integrals.rows,
                    [&](int v)
                    {
                      for (int u = 0; u < line_integrals.cols; ++u)
                      {
                        const Ray ray =
                            geometry.backProject(pixels.first + Eigen::Vector2d(u, v).cwiseProduct(pixels.step));
                        line_integrals.at<float>(v, u) = static_cast<float>(
                            integrate(Ray{ body_from_room * ray.source, body_from_room.linear() * ray.direction }));
                      }
                    });
}
}  // namespace

BodyRenderer::BodyRenderer(ScalarVolume volume, double footprint, double smoothness, Projector projector)
  : smoothness_(smoothness)
{
  ScalarVolume half = halved(volume);
  const auto addLevel = [&](ScalarVolume level)
  {
    const double edge = level.grid.spacing().minCoeff();
    levels_.push_back({ edge, std::make_unique<ShearWarpRenderer>(level), nullptr, nullptr });
    if (projector != Projector::SHEAR_WARP)
    {
      levels_.back().volume = std::make_shared<const ScalarVolume>(std::move(level));
    }
    if (projector == Projector::ATTENUATION_FIELD)
    {
      levels_.back().field = std::make_unique<AttenuationField>(levels_.back().volume, kFieldStep * edge, kFieldBytes);
    }
  };
  // A CT's voxel is a mean over its box, and interpolation is linear: variances of 1/12 and 1/6 of its edge squared,
  // taken away before the bin's is added.
  const Eigen::Vector3d variance = footprint * footprint / 12.0 - 0.25 * volume.grid.spacing().array().square();
  addLevel(filtered(std::move(volume), variance));
  addLevel(std::move(half));
}

const BodyRenderer::Level& BodyRenderer::suiting(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                                                 const Eigen::Vector3d& centre) const
{
  const double step = pixels.step.cwiseProduct(geometry.pixelPitch()).minCoeff() / geometry.magnification(centre);
  const auto coarser = std::find_if(levels_.rbegin(), levels_.rend(),
                                    [&](const Level& level) { return level.edge <= 1.001 * smoothness_ * step; });
  return coarser == levels_.rend() ? levels_.front() : *coarser;
}

void BodyRenderer::renderWithDerivatives(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                                         const RigidTransform& room_from_body, const Eigen::Vector3d& centre,
                                         cv::Mat& line_integrals, cv::Mat& derivatives) const
{
  suiting(geometry, pixels, centre)
      .renderer->renderWithDerivatives(geometry, pixels, room_from_body, centre, line_integrals, derivatives);
}

void BodyRenderer::render(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                          const RigidTransform& room_from_body, const Eigen::Vector3d& centre,
                          cv::Mat& line_integrals) const
{
  const Level& level = suiting(geometry, pixels, centre);
  if (level.field)
  {
    castRays(geometry, pixels, room_from_body, line_integrals,
             [&](const Ray& ray) { return level.field->lineIntegral(ray); });
  }
  else if (level.volume)
  {
    castRays(geometry, pixels, room_from_body, line_integrals,
             [&](const Ray& ray) { return integrateTrilinear(*level.volume, ray); });
  }
  else
  {
    level.renderer->render(geometry, pixels, room_from_body, line_integrals);
  }
}

std::size_t BodyRenderer::memory() const
{
  std::size_t bytes = 0;
  for (const Level& level : levels_)
  {
    bytes += level.renderer->memory();
    bytes += level.volume ? level.volume->values.size() * sizeof(float) : 0;
    bytes += level.field ? level.field->memory() : 0;
  }
  return bytes;
}

AttenuationField::Statistics BodyRenderer::fieldStatistics() const
{
  AttenuationField::Statistics sum{ 0, 0 };
  for (const Level& level : levels_)
  {
    if (level.field)
    {
      const AttenuationField::Statistics statistics = level.field->statistics();
      sum.lookups += statistics.lookups;
      sum.hits += statistics.hits;
    }
  }
  return sum;
}
}  // namespace xray_tracking
