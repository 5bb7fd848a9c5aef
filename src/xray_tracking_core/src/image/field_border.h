#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "image_bins.h"

namespace xray_tracking
{
/// The field's border: what lies outside of the part of an image that X-rays reach.
class FieldBorder
{
public:
  void update(const ImageBins& bins);
  /// All is outside.
  void close(const ImageBins& bins);

  /// Of the bins, CV_8UC1: 255 outside the field and in its penumbra.
  const cv::Mat& outside() const { return outside_; }
  bool any() const { return any_; }

private:
  void leaveBrightestPart();

  bool any_ = false;
  cv::Mat opened_, outside_, framed_, visited_;
  Eigen::ArrayXf largest_of_row_, largest_of_column_;
  std::vector<cv::Point> part_, field_;
};
}  // namespace xray_tracking
