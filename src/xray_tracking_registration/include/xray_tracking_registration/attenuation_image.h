#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// A part of an image in bins, of what is usable alone.
struct AttenuationBins
{
  cv::Mat mean;   ///< CV_32FC1; of a bin without a usable pixel 0
  cv::Mat share;  ///< of a bin's pixels that are usable, CV_32FC1; empty if all of all bins are
};

/// An X-ray image as attenuation, the line integrals that a DRR holds: for counts -log((I - offset) / (air - offset)),
/// counts below offset + 1 taken as that; for attenuation images the values themselves. Without `air_counts` the
/// image's largest value stands for air, which adds a constant that no similarity here depends on. Parts are made when
/// they are asked for, as a target is seen by a part of a panel.
class AttenuationImage
{
public:
  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1; not copied
  /// @throws std::invalid_argument for another type, an empty image, a value that is not finite, or an offset that is
  ///         not below the air counts
  AttenuationImage(const cv::Mat& image, const IntensityModel& intensity);

  cv::Size size() const { return image_.size(); }
  /// Means over bins of the pixels' attenuation.
  /// @param bins of the image, inside of it
  /// @param edge of a bin, 1 or more [px]
  /// @param usable CV_8UC1 of the image's size, 0 for pixels that do not count; empty: all do
  AttenuationBins bins(const cv::Rect& bins, int edge, const cv::Mat& usable = {}) const;

private:
  void readLine(int row, int column, std::vector<float>& values) const;

  cv::Mat image_;
  bool counts_;  ///< else attenuation
  double offset_ = 0.0;
  double air_ = 0.0;
  int most_factors_ = 1;  ///< of which one logarithm is taken
};
}  // namespace xray_tracking
