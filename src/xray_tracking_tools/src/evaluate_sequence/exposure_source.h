#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Files that make a part of what is evaluated.
struct InputFiles
{
  std::string what;  ///< e.g. "images"
  std::vector<std::string> files;
};

/// The exposures of a sequence folder or a bag, in the order of their stamps.
struct ExposureSource
{
  std::string name;
  std::string path;  ///< the folder or the bag
  TreatmentSetup setup;
  std::vector<InputFiles> inputs;  ///< all that was read, but the CT
  std::vector<std::int64_t> stamps_ns;
  std::vector<RigidTransform> gold_standard;  ///< one for each exposure; empty if it is not known
  /// Of the k-th exposure, one for each of the setup's detectors, CV_8UC1 or CV_16UC1.
  /// @throws std::runtime_error naming what cannot be read
  std::function<std::vector<cv::Mat>(std::size_t)> images;

  /// Keeps the first `frames` exposures. @throws std::invalid_argument if there are fewer
  void keepFirst(int frames);
};

/// @throws std::runtime_error as loadSequence()
ExposureSource sequenceSource(const std::string& folder);

/// Exposures of which every detector has an image; the gold standard is `patient_ground_truth`'s if every one has it.
/// Geometry, CT and initial pose are the setup's.
/// @throws std::runtime_error naming the bag and what is wrong: no bag, no exposure, a camera_info that differs from
/// the setup
ExposureSource bagSource(const std::string& bag_path, const std::string& setup_path);
}  // namespace xray_tracking
