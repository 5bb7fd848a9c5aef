#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
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
  /// @param part of the image, inside of it @return CV_32FC1
  cv::Mat operator()(const cv::Rect& part) const;

private:
  float attenuationOf(double counts) const;

  cv::Mat image_;
  bool counts_;  ///< else attenuation
  double offset_ = 0.0;
  double air_ = 0.0;
  std::vector<float> table_;  ///< of all integer counts that there are
};
}  // namespace xray_tracking
