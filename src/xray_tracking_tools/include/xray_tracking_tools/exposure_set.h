#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Exposures held in memory, for benchmarks.
struct ExposureSet
{
  TreatmentSetup setup;
  std::vector<std::vector<cv::Mat>> images;       ///< CV_16UC1 by exposure, then by the setup's detectors
  std::vector<RigidTransform> room_from_patient;  ///< gold standard, one for each exposure; empty if it is not known
};

/// A sequence, where `path` is its folder or its sequence.yaml; for any other setup file the neck phantom in that
/// room: 20 exposures, the whole patient moving by up to 10 mm, quantum noise of one photon a count.
/// @throws std::runtime_error as loadSequence and loadTreatmentSetup
ExposureSet loadExposureSet(const std::string& path);

/// The k-th exposure of the way through `count` exposures and back, over and over: motion stays continuous.
std::size_t backAndForth(std::size_t k, std::size_t count);

/// `$(find xray_tracking_core)/config/NAME`. @throws std::runtime_error if the package is not found
std::string coreConfigPath(const std::string& name);
}  // namespace xray_tracking
