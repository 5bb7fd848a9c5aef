#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// A place where a region may be.
struct RegionCandidate
{
  Eigen::Vector2d displacement;  ///< from where it was learnt [px], to about a pixel of the search's coarse image
  double correlation;            ///< there, -1..1
};

/// Looks for a region everywhere in an image, wherever it was before: normalised correlation of coarse attenuation
/// images without slow shading. Neighbouring vertebrae look alike, and more so when coarse, so what it finds are
/// candidates: the tracker refines each of them (RegionTracker::trackFrom), provenCandidate() decides.
class RegionSearch
{
public:
  /// @param image CV_8UC1 or CV_16UC1; @param region [px], inside the image, 16 px or more in both directions
  /// @param reduction factor by which pixels are smaller than usual, about 0.25 mm at the target; 1 or more
  RegionSearch(const cv::Mat& image, const cv::Rect& region, const IntensityModel& intensity, int reduction = 1);

  /// @param image of any content, of the type of the first one; up to a quarter of the region's width and height may
  ///        lie outside of it
  /// @return the best places, not nearer to one another than a quarter of the region; best first, five at most
  std::vector<RegionCandidate> find(const cv::Mat& image) const;

private:
  cv::Mat coarse(const cv::Mat& image) const;

  IntensityModel intensity_;
  int bin_;         ///< image pixels a coarse pixel
  double shading_;  ///< what is slower counts as shading [coarse px]
  cv::Rect region_;
  cv::Mat patch_;  ///< CV_32FC1, the coarse region
};

/// Which of the candidates that a tracker has refined is the region: the one of best quality, if it was found and
/// leaves clearly less unexplained than any other one at another place; none if two look alike.
/// @param reduction as RegionSearch's
std::optional<std::size_t> provenCandidate(const std::vector<TrackResult>& refined, int reduction = 1);
}  // namespace xray_tracking
