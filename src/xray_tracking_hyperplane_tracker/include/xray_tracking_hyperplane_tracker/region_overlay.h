#pragma once

#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_hyperplane_tracker/region_tracker.h"
#include "xray_tracking_hyperplane_tracker/residual_points.h"

namespace xray_tracking
{
/// What is drawn over an exposure.
struct RegionOverlay
{
  cv::Rect reference;                 ///< the template's region [px], thin and grey; empty: none
  std::optional<TrackResult> found;   ///< where it is, outlined in `colour`; none: the reference is
  cv::Scalar colour;                  ///< blue, green, red, 0..255
  std::vector<ResidualPoint> points;  ///< from green (no residual) to red (as large as the template's contrast)
};

/// A picture for people: grey values windowed to three standard deviations around the mean of the reference region (of
/// the image if there is none), with the regions' outlines and the points.
/// @param image CV_8UC1 or CV_16UC1; @return CV_8UC3 of its size
cv::Mat drawRegionOverlay(const cv::Mat& image, const RegionOverlay& overlay);
}  // namespace xray_tracking
