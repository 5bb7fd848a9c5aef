#pragma once

#include <optional>
#include <string>

#include <ros/node_handle.h>
#include <opencv2/core.hpp>

#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
/// The parameters of the node (README.md).
struct TrackerParameters
{
  HyperplaneTrackerOptions tracker;
  std::string detector;            ///< name in the setup file
  std::string setup_file;          ///< path; empty: none
  std::optional<cv::Rect> region;  ///< [px], goes before what the setup file says
  int queue_size = 20;             ///< exposures that wait while a template is learnt
  double train_timeout = 10.0;     ///< for the exposure that the service train_region waits for [s]
  double image_timeout = 2.0;      ///< without an exposure after which diagnostics say so [s]
};

/// @param default_detector used if `detector` is not set
/// @throws std::invalid_argument naming the parameter, its value and what was expected
TrackerParameters readTrackerParameters(const ros::NodeHandle& pnh, const std::string& default_detector);
}  // namespace xray_tracking
