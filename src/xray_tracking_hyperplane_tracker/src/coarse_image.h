#pragma once

#include <opencv2/core.hpp>

#include "kernels.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Means over square bins of a part of an image, for which the predictors have less noise to bear. Bins are counted
/// from the image's corner, so that those of different parts and images are the same.
class CoarseImage
{
public:
  /// @param bin edge [px]; @param image that gives size and type of all, CV_8UC1 or CV_16UC1
  CoarseImage(const cv::Mat& image, int bin);

  /// Bins what a part of the image covers; no allocation.
  void update(const cv::Mat& image, const cv::Rect& part);

  /// The bins of the last part, CV_16UC1.
  const cv::Mat& pixels() const { return pixels_; }
  int bin() const { return bin_; }  ///< edge [px]
  bool isWhole() const { return pixels_.size() == size_; }
  /// From a map to the image to one to pixels().
  PixelMap toBins(const PixelMap& map) const;
  /// Of pixels(), whose values of 8-bit images are multiplied to use 16 bit.
  IntensityModel intensity(const IntensityModel& of_image) const;

private:
  bool isImageItself() const { return bin_ == 1 && !from_8_bit_; }

  int bin_;
  bool from_8_bit_;
  cv::Size size_;  ///< of the whole image [bins]
  cv::Mat all_;
  cv::Mat pixels_;       ///< part of all_; the image itself where a bin is a pixel
  cv::Mat column_sums_;  ///< of a row of bins
};
}  // namespace xray_tracking
