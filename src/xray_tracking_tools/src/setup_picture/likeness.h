#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// How alike X-rays and DRRs are, coarsely: to see whether something is turned or mirrored, not where it is. Not a
/// measure of trust, which the registration has (docs/belief.md).
struct Likeness
{
  std::vector<double> views;       ///< at the initial pose, -1 to 1 of each detector; 0 where the target is not seen
  std::vector<std::string> words;  ///< what would make them much more alike: an image flipped, the patient turned
                                   ///< or moved by more than 10 mm
};

/// Correlation of details of about a fiftieth to a tenth of the target's size, of the part of the DRR where the target
/// is seen with the part of the X-ray that it fits best, anywhere in it: a pose that is off looks like nothing at its
/// place, and symmetric anatomy would look mirrored elsewhere.
/// @param xrays of the setup's detectors
Likeness likenessOf(const TreatmentSetup& setup, const ShearWarpRenderer& renderer, const std::vector<cv::Mat>& xrays);
}  // namespace xray_tracking
