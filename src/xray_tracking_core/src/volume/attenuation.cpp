#include "xray_tracking_core/volume/attenuation.h"

#include <algorithm>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace xray_tracking
{
Materials materialsFromHu(double hu)
{
  constexpr double kDensestSoftTissue = 1.1;  // 100 HU
  const double relative = 1.0 + hu / 1000.0;  // attenuation in units of water's
  constexpr double kRelativeBone = kBoneAttenuation / kWaterAttenuation;

  Materials materials;
  if (relative <= kDensestSoftTissue)
  {
    materials.soft = std::max(0.0, relative);
  }
  else if (relative < kRelativeBone)
  {
    materials.bone = (relative - kDensestSoftTissue) / (kRelativeBone - kDensestSoftTissue);
    materials.soft = kDensestSoftTissue * (1.0 - materials.bone);
  }
  else
  {
    // Teeth and metal: as if bone of more than its nominal density.
    materials.bone = relative / kRelativeBone;
  }
  return materials;
}

ScalarVolume attenuationVolume(const CtVolume& ct)
{
  ScalarVolume attenuation{ ct.grid, std::vector<float>(ct.hu.size()) };
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, ct.hu.size(), 1 << 16),
                    [&](const tbb::blocked_range<std::size_t>& range)
                    {
                      for (std::size_t n = range.begin(); n != range.end(); ++n)
                      {
                        attenuation.values[n] = static_cast<float>(attenuationFromHu(ct.hu[n]));
                      }
                    });
  return attenuation;
}
}  // namespace xray_tracking
