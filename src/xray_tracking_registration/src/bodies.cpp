#include "bodies.h"

#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "xray_tracking_core/volume/resampling.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace xray_tracking
{
namespace
{
constexpr double kFineVoxel = 1.2;  // edge up to which the rest's voxels are halved [mm]

constexpr double kNextToNothing = 0.02;

/// Attenuation times volume.
double amountOf(const ScalarVolume& volume)
{
  return std::accumulate(volume.values.begin(), volume.values.end(), 0.0) *
         std::abs(volume.grid.patient_from_index.linear().determinant());
}

/// Calls visit(offset in the volume, weight) for every voxel of the mask, whose grid is a part of the volume's.
template <typename Visit>
void forVoxels(const VolumeGrid& volume, const TargetMask& mask, Visit visit)
{
  const Eigen::Affine3d volume_from_mask = volume.patient_from_index.inverse() * mask.grid.patient_from_index;
  const Eigen::Vector3i first = volume_from_mask.translation().array().round().cast<int>();
  std::size_t n = 0;
  for (int k = 0; k < mask.grid.size.z(); ++k)
  {
    for (int j = 0; j < mask.grid.size.y(); ++j)
    {
      for (int i = 0; i < mask.grid.size.x(); ++i, ++n)
      {
        visit(volume.offset(first.x() + i, first.y() + j, first.z() + k), mask.values[n]);
      }
    }
  }
}
}  // namespace

Bodies::Bodies(const BodyModel& model, const Eigen::AlignedBox3d& target_box, double footprint, Projector projector)
  : centre(target_box.center()), one(model.rest.values.empty())
{
  if (model.target.values.empty())
  {
    throw std::invalid_argument("bodies: the target has no voxel");
  }
  // The rest is a nuisance, and most of the voxels: two millimetres do for it. Coarser, what its edges lack is taken
  // for a motion of the target.
  const ScalarVolume& whole = one ? model.target : model.rest;
  ScalarVolume smooth = whole.grid.spacing().minCoeff() < kFineVoxel ? halved(whole) : whole;
  rest_ends = CtEnds(smooth);
  if (one)
  {
    const TargetMask mask = targetMaskFromBox(model.target.grid, target_box);
    ScalarVolume inside{ mask.grid, {} };
    forVoxels(model.target.grid, mask,
              [&](std::size_t offset, float weight) { inside.values.push_back(weight * model.target.values[offset]); });
    target = std::make_unique<BodyRenderer>(std::move(inside), footprint, 1.0, projector);
    forVoxels(smooth.grid, targetMaskFromBox(smooth.grid, target_box),
              [&](std::size_t offset, float weight) { smooth.values[offset] *= 1.0f - weight; });
    surrounded = amountOf(smooth) > kNextToNothing * amountOf(model.target);
  }
  else
  {
    // Its weight falls to zero within the CT, or else the CT ends there.
    target_ends = CtEnds(model.target);
    target = std::make_unique<BodyRenderer>(model.target, footprint, 1.0, projector);
  }
  constexpr double kSmoothness = 1.5;
  rest = std::make_unique<BodyRenderer>(std::move(smooth), footprint, kSmoothness, projector);
}
}  // namespace xray_tracking
