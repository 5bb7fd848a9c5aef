#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// An image in a few robust values: medians of nine pixels each, spread over square bins, which single stuck pixels do
/// not reach.
class ImageBins
{
public:
  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1
  void update(const cv::Mat& image, const IntensityModel& intensity);

  int edge() const { return edge_; }                 ///< of a bin [px]
  const cv::Mat& values() const { return values_; }  ///< as in the image, CV_32FC1
  /// Bright where the image is lit, CV_32FC1: counts less offset, 0 or more, or exp(-attenuation).
  const cv::Mat& light() const { return light_; }
  double largest() const { return largest_; }  ///< of values()
  double smallest() const { return smallest_; }
  float brightest() const { return brightest_; }  ///< of light(), but for the largest twentieth
  float step() const { return step_; }            ///< of light(), where it is in whole numbers; else 0
  float noise() const
  {
    return noise_;
  }  ///< standard deviation of a pixel of light(), median over the bins; of counts alone, else 0
  /// Of neighbouring bins, -1..1; 0 if all are the same.
  double correlation() const;

private:
  template <typename Pixel>
  void fill(const cv::Mat& image);

  int edge_ = 1;
  cv::Mat values_, light_;
  double largest_ = 0.0, smallest_ = 0.0;
  float brightest_ = 0.f, noise_ = 0.f, step_ = 0.f;
  std::vector<float> spreads_, sorted_;
};
}  // namespace xray_tracking
