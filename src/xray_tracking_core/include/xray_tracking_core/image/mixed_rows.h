#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/image/xray_field.h"

namespace xray_tracking
{
/// Tells that an image's rows are of two exposures between which what is seen has moved: every other one (fields that
/// were woven together), or all below one (a buffer that was read while it was written).
///
/// - Woven: what alternates from row to row, is the same in rows three to six away, which no noise is, and is more than
///   a gain and an offset of every other row (two amplifiers). Against the image's slopes it is a distance of the
///   fields.
/// - Torn: in all columns, the step from one row to the next is larger than those before and behind it, and than
///   all others usually are, by more than a detector's blur lets an edge be, along the rows as the image's slopes are,
///   and is more than a gain and an offset of all that follows (a panel of two halves).
///
/// Where nothing moved there is nothing to be told, and no harm. Not thread-safe.
class MixedRows
{
public:
  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1, without stuck pixels, rows and letters
  /// @param part where woven rows are looked for; cut at the image's border
  /// @param field of the image's exposure: a seam is looked for in all of its rows, in the part's columns and as many
  ///        beside them
  /// @return what is wrong; empty: nothing, or the part is less than 48 x 48. Valid until the next call
  const std::string& look(const cv::Mat& image, const cv::Rect& part, const XrayField& field);

private:
  /// How far apart two fields are [px], 0 if they are not told to be.
  double woven(const cv::Mat& image, const cv::Rect& part);
  /// The row behind a seam, -1 if there is none.
  int torn(const cv::Mat& image, const cv::Rect& field);

  cv::Mat values_, alternating_;
  Eigen::ArrayXf products_, step_, middle_, sorted_;
  std::vector<double> sums_;
  double slopes_ = 0.0;       ///< of the part, mean squares [1/px^2]
  Eigen::ArrayXXf energies_;  ///< of the steps behind the rows, in bands of columns
  Eigen::ArrayXf all_;        ///< and in all
  std::string fault_;
};
}  // namespace xray_tracking
