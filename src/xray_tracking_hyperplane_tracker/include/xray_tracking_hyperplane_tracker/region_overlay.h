#pragma once

#include <optional>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// What is drawn over an exposure.
struct RegionOverlay
{
  cv::Rect reference;                           ///< the template's region [px], thin and grey; empty: none
  std::optional<Eigen::Vector2d> displacement;  ///< of the tracked region, drawn in `colour`; none: the reference is
  cv::Scalar colour;                            ///< blue, green, red, 0..255
};

/// A picture for people: grey values windowed to three standard deviations around the mean of the reference region (of
/// the image if there is none), with the regions' outlines.
/// @param image CV_8UC1 or CV_16UC1; @return CV_8UC3 of its size
cv::Mat drawRegionOverlay(const cv::Mat& image, const RegionOverlay& overlay);
}  // namespace xray_tracking
