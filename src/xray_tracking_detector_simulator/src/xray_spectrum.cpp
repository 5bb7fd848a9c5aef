#include "xray_tracking_detector_simulator/xray_spectrum.h"

#include <cmath>

#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr double kBoneDensity = 1.92;  // [g/cm^3]
constexpr double kMillimetresPerCentimetre = 10.0;

/// @param soft, bone mass attenuation coefficients [cm^2/g]
SpectralLine line(double energy, double weight, double soft, double bone)
{
  return { energy, weight, soft / kMillimetresPerCentimetre, bone * kBoneDensity / kMillimetresPerCentimetre };
}
}  // namespace

const std::vector<SpectralLine>& filteredBeam()
{
  static const std::vector<SpectralLine> beam = {
    line(40.0, 0.16, 0.2683, 0.6655), line(50.0, 0.23, 0.2269, 0.4242),  line(60.0, 0.27, 0.2059, 0.3148),
    line(80.0, 0.22, 0.1837, 0.2229), line(100.0, 0.12, 0.1707, 0.1855),
  };
  return beam;
}

const std::vector<SpectralLine>& monochromaticBeam()
{
  static const std::vector<SpectralLine> beam = { { 70.0, 1.0, kWaterAttenuation, kBoneAttenuation } };
  return beam;
}

double primaryTransmission(const std::vector<SpectralLine>& beam, double soft_length, double bone_length)
{
  double transmission = 0.0;
  for (const SpectralLine& line : beam)
  {
    transmission += line.weight * std::exp(-line.soft * soft_length - line.bone * bone_length);
  }
  return transmission;
}
}  // namespace xray_tracking
