#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "exposure_source.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"

namespace xray_tracking
{
/// Draws the first, the middle, the last and the worst exposure of every view into `folder`/pictures: the radiograph
/// around the target, and the edges of the target's DRR at the method's pose as an image of the same size that is
/// transparent elsewhere.
/// @param method that the pictures are of; the worst exposure is the one of its largest error
/// @param target the target's attenuation; null: no edges
/// @return an array with an object for each picture: frame, why, detector, crop [px of the detector], radiograph, edges
/// (paths in the folder; edges is null if there are none)
/// @throws std::runtime_error naming a file that cannot be written
nlohmann::json drawPictures(const ExposureSource& source, const MethodResult& method, const ShearWarpRenderer* target,
                            const std::string& folder);
}  // namespace xray_tracking
