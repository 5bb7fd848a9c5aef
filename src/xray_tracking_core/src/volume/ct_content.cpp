#include "xray_tracking_core/volume/ct_content.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "ct_error.h"
#include "stored_volume.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr double kDepth = 2.0;       // below a surface [mm]
constexpr std::int16_t kAir = -500;  // below [HU]
constexpr double kBackgroundShare = 1.0 / 3.0;
constexpr double kBoneAtSurface = 0.5;  // of all surfaces
constexpr double kNoRest = 0.02;        // of the target's attenuation
constexpr std::array<std::pair<const char*, CtContent>, 4> kNames = { { { "recognised", CtContent::RECOGNISED },
                                                                        { "full", CtContent::FULL },
                                                                        { "bone_in_air", CtContent::BONE_IN_AIR },
                                                                        { "labels", CtContent::LABELS } } };

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

/// What a CT of bone alone adds to water, as HU of a body in air.
CtVolume addedToWater(const PatientCt& ct)
{
  const int bone = static_cast<int>(std::lround(huFromMaterials({ 0.0, 1.0 })));
  CtVolume added = ct.volume;
  for (std::int16_t& value : added.hu)
  {
    const int hu = ct.content != CtContent::LABELS ? value : value != 0 ? bone : 0;
    value = static_cast<std::int16_t>(std::max(hu, 0) - 1000);
  }
  return added;
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
  throw std::invalid_argument("ct_content is " + name + ": expected recognised, full, bone_in_air or labels");
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

PatientCt readPatientCt(const std::string& path, CtContent content, const CtChoice& choice)
{
  StoredVolume stored = readStoredVolume(path, choice);
  const std::string no_hu = whyNotHu(stored.volume);
  const std::string no_labels = whyNotLabels(stored);
  if (content == CtContent::RECOGNISED)
  {
    if (no_hu.empty())
    {
      return recognisedCt(std::move(stored.volume));
    }
    if (!no_labels.empty() || !isPatchwork(stored.volume))
    {
      failCt(path, "neither Hounsfield units: " + no_hu +
                       "; nor labels: " + (no_labels.empty() ? "its values differ from voxel to voxel" : no_labels));
    }
    content = CtContent::LABELS;
  }
  const std::string& fault = content == CtContent::LABELS ? no_labels : no_hu;
  if (!fault.empty())
  {
    failCt(path, "ct_content is " + nameOf(content) + ", but these are no " +
                     (content == CtContent::LABELS ? "labels: " : "Hounsfield units: ") + fault);
  }
  return { std::move(stored.volume), content };
}

PatientCt recognisedCt(CtVolume hu)
{
  const CtContent content = recognisedContent(hu);
  return { std::move(hu), content };
}

TargetMask targetMaskOf(const PatientCt& ct, const Eigen::AlignedBox3d& target_box, const TargetMaskOptions& options)
{
  return ct.content == CtContent::LABELS ? targetMaskFromLabels(ct.volume, target_box, options)
                                         : targetMaskFromBone(ct.volume, target_box, options);
}

BodyModel bodiesOf(const PatientCt& ct, const std::optional<TargetMask>& mask)
{
  if (ct.content != CtContent::FULL)
  {
    return bodiesOf({ addedToWater(ct), CtContent::FULL }, mask);
  }
  if (mask)
  {
    BodyModel bodies = splitBodies(ct.volume, *mask);
    if (sumOf(bodies.rest) >= kNoRest * sumOf(bodies.target))
    {
      return bodies;
    }
  }
  return oneBody(ct.volume);
}
}  // namespace xray_tracking
