#pragma once

#include <algorithm>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// An image in a few robust values: medians of three pixels each, spread over square bins.
class ImageBins
{
public:
  /// @param bins along the longer side
  explicit ImageBins(int bins) : bins_(bins) {}

  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1
  void update(const cv::Mat& image, const IntensityModel& intensity);

  int edge() const { return edge_; }           ///< of a bin [px]
  double largest() const { return largest_; }  ///< in the image's values
  double smallest() const { return smallest_; }
  /// Bright where the image is lit, CV_32FC1: counts less offset, 0 or more, or exp(-attenuation).
  const cv::Mat& light() const { return light_; }
  float brightest() const { return brightest_; }  ///< of light(), but for the largest twentieth
  float step() const { return step_; }            ///< of light(), where it is in whole numbers; else 0
  float noise() const { return noise_; }          ///< standard deviation of a pixel's light in quiet bins; counts only
  float quantum() const { return quantum_; }      ///< variance of a pixel's light in units of it; counts only, else 0
  /// By how much a pixel's variance grows with its light: that of quanta, without what a panel adds of its own.
  float growth() const { return growth_; }
  float growthError() const { return growth_error_; }  ///< its standard deviation
  /// Of neighbouring bins along rows or along columns, whichever is less, about -1..1; 0 if all are the same.
  double correlation() const;

private:
  /// Of three pixels.
  struct Sample
  {
    Sample(float a, float b, float c)
    {
      const float low = std::min(a, b), high = std::max(a, b);
      value = std::max(low, std::min(high, c));
      range = std::max(high, c) - std::min(low, c);
    }
    float value;  ///< the median
    float range;
  };

  template <typename Pixel>
  void fill(const cv::Mat& image);
  void measureNoise(double offset);

  int bins_;
  int edge_ = 1;
  cv::Mat values_, light_;
  double largest_ = 0.0, smallest_ = 0.0;
  float brightest_ = 0.f, step_ = 0.f, noise_ = 0.f, quantum_ = 0.f, growth_ = 0.f, growth_error_ = 0.f;
  int every_ = 1;  ///< bin is a sample
  std::vector<Sample> samples_;
  std::vector<float> sorted_;
};
}  // namespace xray_tracking
