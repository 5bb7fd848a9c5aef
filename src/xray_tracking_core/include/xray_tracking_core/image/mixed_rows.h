#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Tells that every other row of an image is of another exposure, between which what is seen has moved: fields that
/// were woven together.
///
/// What alternates from row to row, is the same in rows three to six away, which no noise is, and is more than a gain
/// and an offset of every other row (two amplifiers). Against the image's slopes it is a distance of the fields. Where
/// nothing moved there is nothing to be told, and no harm. Not thread-safe.
class MixedRows
{
public:
  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1, without stuck pixels, rows and letters
  /// @param part what is looked at, cut at the image's border
  /// @return what is wrong; empty: nothing, or the part is less than 48 x 48. Valid until the next call
  const std::string& look(const cv::Mat& image, const cv::Rect& part);

private:
  /// How far apart two fields are [px], 0 if they are not told to be.
  double woven(const cv::Mat& image, const cv::Rect& part);

  cv::Mat values_, alternating_;
  Eigen::ArrayXf products_;
  std::vector<double> sums_;
  std::string fault_;
};
}  // namespace xray_tracking
