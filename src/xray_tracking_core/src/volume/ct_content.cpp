#include "xray_tracking_core/volume/ct_content.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

namespace xray_tracking
{
namespace
{
constexpr double kDepth = 2.0;       // below a surface [mm]
constexpr std::int16_t kAir = -500;  // below [HU]
constexpr double kBackgroundShare = 1.0 / 3.0;
constexpr double kBoneAtSurface = 0.5;  // of all surfaces
constexpr double kNoRest = 0.02;        // of the target's attenuation
constexpr std::array<std::pair<const char*, CtContent>, 3> kNames = {
  { { "recognised", CtContent::RECOGNISED }, { "full", CtContent::FULL }, { "bone_in_air", CtContent::BONE_IN_AIR } }
};

/// The most frequent value if at least a third of all voxels have it; else one that no voxel has.
int backgroundOf(const std::vector<std::int16_t>& hu)
{
  constexpr int kNone = 1 << 16;
  std::vector<std::size_t> counts(1 << 16);
  for (const std::int16_t value : hu)
  {
    ++counts[static_cast<std::uint16_t>(value)];
  }
  const auto most = std::max_element(counts.begin(), counts.end());
  return static_cast<double>(*most) >= kBackgroundShare * static_cast<double>(hu.size())
             ? static_cast<std::int16_t>(most - counts.begin())
             : kNone;
}

double sumOf(const ScalarVolume& volume)
{
  return std::accumulate(volume.values.begin(), volume.values.end(), 0.0);
}
}  // namespace

CtContent ctContentNamed(const std::string& name)
{
  for (const auto& [known, content] : kNames)
  {
    if (name == known)
    {
      return content;
    }
  }
  throw std::invalid_argument("ct_content is " + name + ": expected recognised, full or bone_in_air");
}

std::string nameOf(CtContent content)
{
  return std::find_if(kNames.begin(), kNames.end(), [&](const auto& known) { return known.second == content; })->first;
}

CtContent recognisedContent(const CtVolume& ct)
{
  const double threshold_hu = TargetMaskOptions().threshold_hu;
  const int background = backgroundOf(ct.hu);
  const auto isNothing = [&](std::int16_t hu) { return hu < kAir || hu == background; };
  const Eigen::Vector3i& size = ct.grid.size;
  const std::array<std::ptrdiff_t, 3> stride{ 1, size.x(), static_cast<std::ptrdiff_t>(size.x()) * size.y() };
  const Eigen::Vector3i depth = (kDepth / ct.grid.spacing().array()).ceil().cast<int>();
  std::size_t surfaces = 0;
  std::size_t of_bone = 0;
  std::ptrdiff_t n = 0;
  for (int k = 0; k < size.z(); ++k)
  {
    for (int j = 0; j < size.y(); ++j)
    {
      for (int i = 0; i < size.x(); ++i, ++n)
      {
        if (!isNothing(ct.hu[n]))
        {
          continue;
        }
        const Eigen::Vector3i voxel(i, j, k);
        for (int axis = 0; axis < 3; ++axis)
        {
          for (const int side : { -1, 1 })
          {
            const int room = side < 0 ? voxel[axis] : size[axis] - 1 - voxel[axis];
            const std::ptrdiff_t step = side * stride[axis];
            if (room < 1 || isNothing(ct.hu[n + step]))
            {
              continue;
            }
            ++surfaces;
            for (int d = 1; d <= std::min(room, depth[axis]); ++d)
            {
              if (ct.hu[n + d * step] >= threshold_hu)
              {
                ++of_bone;
                break;
              }
            }
          }
        }
      }
    }
  }
  return static_cast<double>(of_bone) > kBoneAtSurface * static_cast<double>(surfaces) ? CtContent::BONE_IN_AIR
                                                                                       : CtContent::FULL;
}

CtVolume addedToWater(CtVolume ct)
{
  for (std::int16_t& hu : ct.hu)
  {
    hu = static_cast<std::int16_t>(std::max<int>(hu, 0) - 1000);
  }
  return ct;
}

BodyModel bodiesOf(const CtVolume& ct, const std::optional<TargetMask>& mask, CtContent content)
{
  if (content == CtContent::RECOGNISED)
  {
    content = recognisedContent(ct);
  }
  if (content == CtContent::BONE_IN_AIR)
  {
    return bodiesOf(addedToWater(ct), mask, CtContent::FULL);
  }
  if (mask)
  {
    BodyModel bodies = splitBodies(ct, *mask);
    if (sumOf(bodies.rest) >= kNoRest * sumOf(bodies.target))
    {
      return bodies;
    }
  }
  return oneBody(ct);
}
}  // namespace xray_tracking
