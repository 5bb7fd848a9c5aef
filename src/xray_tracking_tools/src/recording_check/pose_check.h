#pragma once

#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_tools/finding.h"

namespace xray_tracking
{
/// What is wrong with a setup by itself, and with its CT, target and initial pose against the first exposure.
/// @param images of the setup's detectors; empty: there is no exposure to compare with
/// @param gold_standard in that exposure, if it is known
std::vector<Finding> checkPose(const TreatmentSetup& setup, const std::vector<cv::Mat>& images,
                               const std::optional<RigidTransform>& gold_standard);
}  // namespace xray_tracking
