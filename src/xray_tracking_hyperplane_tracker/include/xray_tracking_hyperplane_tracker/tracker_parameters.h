#pragma once

#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
/// The parameters of the node (README.md).
struct TrackerParameters
{
  TrackerParameters() { tracker.model = MotionModel::EUCLIDEAN; }  // of model `auto`

  bool model_by_data = true;         ///< model `auto`: EUCLIDEAN where it tells a rotation, else TRANSLATION
  HyperplaneTrackerOptions tracker;  ///< lengths, and reduction, as of scaleTo()
  /// Lengths at the target [mm]: of pixels that the tracker works on, about, and what is in pixels in its options.
  double resolution = 0.25;
  std::vector<double> ranges{ 10.8, 4.3, 1.35 };
  double convergence = 0.0135;
  double max_predicted_sd = 0.08;
  std::string detector;                ///< name in the setup file
  std::string setup_file;              ///< path; empty: none
  std::optional<cv::Rect> region;      ///< [px], goes before what the setup file says
  std::optional<cv::Size> image_size;  ///< the setup file's [px]
  int queue_size = 20;                 ///< exposures that wait while a template is learnt
  double max_wait = 0.5;               ///< of an exposure, after which newer ones go before it [s]
  double train_timeout = 10.0;         ///< for the exposure that training services wait for [s]
  double image_timeout = 2.0;          ///< without an exposure after which diagnostics say so [s]
  bool overlay_points = true;          ///< whether the debug image shows residuals
  bool keep_for_restart = false;       ///< on disk, the template for a tracker in the place of this one

  /// Sets the tracker's options to these lengths. @param pixel size of the detector's pixels at the target [mm]
  void scaleTo(double pixel);

  /// Takes the scale of lengths, the size of images, and the region if there is none, from the setup's `detector`.
  /// @throws std::invalid_argument if there is no such detector, or the target is behind its source
  void adopt(const TreatmentSetup& setup);

  /// @throws std::invalid_argument naming the parameter, its value and what was expected
  void validate() const;
};

/// @param default_detector used if `detector` is not set
/// @throws std::invalid_argument as TrackerParameters::validate
TrackerParameters readTrackerParameters(ParameterReader reader, const std::string& default_detector);
}  // namespace xray_tracking
