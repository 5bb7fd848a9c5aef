#pragma once

#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// Linear attenuation of water at 70 keV, about the effective energy of a 120 kV CT [1/mm] (NIST XCOM: 0.1929 cm^2/g).
constexpr double kWaterAttenuation = 0.01929;
/// Linear attenuation of cortical bone (ICRU-44, 1.92 g/cm^3) at 70 keV [1/mm].
constexpr double kBoneAttenuation = 0.0500;

/// Amounts of the two materials in a point, as fractions of their nominal densities (water 1 g/cm^3, cortical bone
/// 1.92 g/cm^3); along a ray, lengths [mm] of the nominal materials.
struct Materials
{
  double soft = 0.0;
  double bone = 0.0;
};

/// HU to linear attenuation [1/mm] at 70 keV: water * (1 + HU / 1000), not below zero.
inline double attenuationFromHu(double hu)
{
  return hu > -1000.0 ? kWaterAttenuation * (1.0 + hu / 1000.0) : 0.0;
}

/// HU of a mixture at 70 keV.
inline double huFromMaterials(const Materials& m)
{
  return 1000.0 * ((m.soft * kWaterAttenuation + m.bone * kBoneAttenuation) / kWaterAttenuation - 1.0);
}

/// Splits HU into the two materials: soft tissue of varying density up to 100 HU, above that a mixture of soft tissue
/// of 100 HU and cortical bone, so that huFromMaterials(materialsFromHu(hu)) == hu for hu >= -1000.
Materials materialsFromHu(double hu);

/// Every voxel's linear attenuation [1/mm].
ScalarVolume attenuationVolume(const CtVolume& ct);
}  // namespace xray_tracking
