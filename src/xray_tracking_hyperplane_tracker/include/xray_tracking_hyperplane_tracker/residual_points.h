#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// How a tracked region differs from its template at one place.
struct ResidualPoint
{
  cv::Point2f place;  ///< in the image [px]
  float residual;     ///< difference of attenuation without shading, in standard deviations of the template's
};

/// For people: the differences at a grid of points of the region, each of means over a cell, after the fit of contrast
/// and shading (polynomials up to second order) that a tracker does not see either.
/// @param reference the template's image; @param region the template's, inside of it
/// @param image of the reference's size and type; @param track what was found in it
/// @return about 400 points, without those outside the image; none if there are too few
std::vector<ResidualPoint> residualPoints(const cv::Mat& reference, const cv::Rect& region, const cv::Mat& image,
                                          const TrackResult& track, const IntensityModel& intensity);
}  // namespace xray_tracking
