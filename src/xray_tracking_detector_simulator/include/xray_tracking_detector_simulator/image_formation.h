#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_detector_simulator/random_stream.h"
#include "xray_tracking_detector_simulator/xray_spectrum.h"

namespace xray_tracking
{
/// A detector's imperfections; each is off at zero.
struct ImageFormationOptions
{
  bool polychromatic = true;       ///< filteredBeam(); false: monochromaticBeam()
  double scatter_fraction = 0.2;   ///< scattered over primary signal deep behind an object, 0 to 1
  double scatter_sigma_px = 60.0;  ///< width of the scatter's spread (Gaussian), 8 to 1000 [px]
  double blur_sigma_px = 0.6;      ///< width of the detector's point spread (Gaussian), 0 to 20 [px]
  double air_quanta = 60000.0;     ///< quanta that a pixel detects behind air, 0 to 1e9; 0: no quantum noise
  double electronic_noise = 5.0;   ///< standard deviation, 0 to 1e4 [counts]
  double gain_drift = 0.02;        ///< greatest relative change of the gain over the exposures, 0 to 0.5
  double offset_drift = 10.0;      ///< greatest change of the offset over the exposures, 0 to 1e4 [counts]
  int bits = 16;                   ///< saturation at 2^bits - 1 counts, 14 to 16

  /// @throws std::invalid_argument naming the key (`image/...`), its value and the range
  void validate() const;
};

/// Makes the counts that a detector reads out of the material that its rays cross. With P the primary transmission of
/// the beam (1 behind air), in this order:
///   - scatter: S = scatter_fraction * G * (P (1 - P)), G a wide Gaussian: a fraction of the primary, smooth, none
///     where nothing is crossed;
///   - quantum noise: P + S becomes a Poisson variate of mean air_quanta (P + S), see poissonFromNormal;
///   - blur by the detector's point spread, which correlates the quantum noise as a scintillator does;
///   - counts: offset + d_o(k) + (air_counts - offset) (1 + d_g(k)) (P + S) + electronic noise, rounded and clipped to
///     0 .. 2^bits - 1; d_g and d_o change slowly with the exposure k, each within its bound.
/// All noise depends on (seed, detector, exposure) alone, not on the number of threads or the order of calls.
class ImageFormation
{
public:
  /// @param intensity what the counts mean: needs kind COUNTS, and air_counts above the offset
  /// @throws std::invalid_argument naming the key
  ImageFormation(const ImageFormationOptions& options, const IntensityModel& intensity, std::uint64_t seed);

  /// Forms one image, on all cores. Uses buffers of its own: one call at a time.
  /// @param soft, bone CV_32FC1 [mm], as from Anatomy::materials
  /// @param detector, exposure indices, from 0
  /// @param counts out, CV_16UC1, of the same size; re-used if it has that size and type
  void form(const cv::Mat& soft, const cv::Mat& bone, int detector, int exposure, cv::Mat& counts);

private:
  void computePrimary(const cv::Mat& soft, const cv::Mat& bone);
  void addScatter();
  void addQuantumNoise(const RandomStream& stream);
  void readOut(const RandomStream& stream, double gain, double offset, cv::Mat& counts) const;

  ImageFormationOptions options_;
  const std::vector<SpectralLine>& beam_;
  double offset_;
  double air_signal_;
  RandomStream stream_;
  cv::Mat signal_;  ///< relative to air
  cv::Mat scatter_;
  cv::Mat small_scatter_;
};
}  // namespace xray_tracking
