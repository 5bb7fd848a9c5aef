#pragma once

#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_search.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// A tracker that looks for its region in the whole image as soon as it has lost it, and for as long as it is lost.
///
/// Once lost, a region counts as found only when it is proven (provenCandidate): of the places that look like it, the
/// last good one among them, one is clearly better than all others, and as good as the region was before the loss. So
/// nothing that takes the region's place meanwhile, a neighbour, is followed, nor one that stays when the region has
/// left the image. What neither can tell is a neighbour that is the region's twin while the region is outside.
class RecoveringTracker
{
public:
  /// @param reduction as RegionSearch's
  RecoveringTracker(std::unique_ptr<RegionTracker> tracker, const IntensityModel& intensity, int reduction = 1)
    : tracker_(std::move(tracker)), intensity_(intensity), reduction_(reduction)
  {
  }

  /// As RegionTracker::train. @throws as it does; an earlier template stays
  void train(const cv::Mat& image, const cv::Rect& region);
  /// As RegionTracker::retrain.
  bool retrain(const cv::Mat& image) { return tracker_->retrain(image); }
  void reset();
  bool trained() const { return tracker_->trained(); }
  cv::Rect region() const { return tracker_->region(); }
  /// The region counts as lost: it has to be proven, wherever it is. @param usual as usualUnexplained()
  void setLost(const std::optional<double>& usual)
  {
    lost_ = true;
    usual_unexplained_ = usual;
  }
  /// 1 - correlation^2 that tracked images have left; nothing before there were any.
  const std::optional<double>& usualUnexplained() const { return usual_unexplained_; }
  /// Whether the last track() did not find the region.
  bool lost() const { return lost_; }
  /// Where the region was last found [px], its size kept.
  cv::Rect lastPlace() const
  {
    return region() +
           cv::Point(static_cast<int>(std::lround(last_good_.x())), static_cast<int>(std::lround(last_good_.y())));
  }

  /// As RegionTracker::track; where it fails at most seven more of its searches in the same image.
  const TrackResult& track(const cv::Mat& image);
  const TrackResult& result() const { return result_; }

private:
  void recover(const cv::Mat& image);
  bool asBefore(const TrackResult& found) const;
  bool isTemplates(const cv::Mat& image) const;

  std::unique_ptr<RegionTracker> tracker_;
  IntensityModel intensity_;
  int reduction_;
  std::optional<RegionSearch> search_;
  Eigen::Vector2d last_good_ = Eigen::Vector2d::Zero();  ///< displacement [px]
  cv::Mat template_pixels_;                              ///< of the region
  /// 1 - correlation^2: the most that tracked images have left, those long ago less. Nothing if there was no image but
  /// the template's own, which leaves nothing whatever the region usually does.
  std::optional<double> usual_unexplained_;
  bool lost_ = false;
  TrackResult result_;
};
}  // namespace xray_tracking
