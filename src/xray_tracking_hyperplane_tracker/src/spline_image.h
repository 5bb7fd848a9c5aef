#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "kernels.h"

namespace xray_tracking
{
/// A part of an image as sampleSpline() wants it. What is beyond the image is as its nearest pixel.
class SplineImage
{
public:
  /// @param step distance of the places that are sampled at once [px]; @param most largest part, both ways [px]
  SplineImage(int step, int most);

  /// Takes in a part of an image; no allocation. @return whether it is not larger than the largest
  bool update(const cv::Mat& image, const cv::Rect& part);
  void clear() { part_ = cv::Rect(); }
  const cv::Rect& part() const { return part_; }  ///< of the image; empty: none
  /// Of the part.
  SplineSource source() const;
  /// From a map to the image to one to the part.
  PixelMap toPart(PixelMap map) const;

private:
  template <typename Pixel>
  void fill(const cv::Mat& image);

  int step_;
  cv::Mat values_;                    ///< CV_32FC1; a row is a row of the part
  int plane_;                         ///< of the columns 0, step, 2 step ...: length in a row
  std::vector<std::int32_t> column_;  ///< where it is in a row
  cv::Rect part_;
};

/// What sampleSpline() finds at the pixels of an image. @param image CV_32FC1
cv::Mat splineFiltered(const cv::Mat& image);
}  // namespace xray_tracking
