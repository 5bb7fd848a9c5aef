#pragma once

#include <vector>

namespace xray_tracking
{
/// One energy of a beam as the detector sees it.
struct SpectralLine
{
  double energy;  ///< [keV]
  double weight;  ///< share of the detector's signal behind air; all lines add up to 1
  double soft;    ///< linear attenuation of water, 1 g/cm^3 [1/mm]
  double bone;    ///< linear attenuation of cortical bone (ICRU-44), 1.92 g/cm^3 [1/mm]
};

/// Five energies in the place of a filtered 120 kVp tungsten beam on an energy-integrating detector. The attenuation is
/// NIST's (Hubbell and Seltzer, "X-Ray Mass Attenuation Coefficients", NISTIR 5632, tables 3 and 4); the weights are
/// rounded to what such a beam looks like (signal-weighted mean 64 keV), not those of one particular tube.
const std::vector<SpectralLine>& filteredBeam();

/// The single energy of 70 keV for which the core's attenuation constants stand.
const std::vector<SpectralLine>& monochromaticBeam();

/// The detector's primary signal relative to air behind lengths of the two materials [mm] (Beer and Lambert):
/// sum over the lines of weight * exp(-soft * length - bone * length).
double primaryTransmission(const std::vector<SpectralLine>& beam, double soft_length, double bone_length);
}  // namespace xray_tracking
