#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Normalised mutual information of two images (Studholme 1999), (H(a) + H(b)) / H(a, b): 1 if they know nothing of one
/// another, 2 if each follows from the other. Entropies of the joint histogram: `a` counts in its nearest bin, `b` in
/// the two bins around it, linearly, so that the measure changes continuously with `b`.
class NormalisedMutualInformation
{
public:
  /// @param bins a side of the joint histogram, 2 or more
  explicit NormalisedMutualInformation(int bins) : joint_(bins, bins) {}

  int bins() const { return static_cast<int>(joint_.rows()); }
  /// @param a, b CV_32FC1 of one size; values count in bins: whole numbers are the bins' centres, values outside of
  ///        0 .. bins - 1 count as the nearest of these. 1 if both are constant.
  double operator()(const cv::Mat& a, const cv::Mat& b);

private:
  Eigen::ArrayXXf joint_;  ///< b's bin, a's bin
};

/// Gradient correlation (Penney 1998): the mean of the normalised cross-correlations of the two images' derivatives
/// along x and along y, central differences; -1..1. 0 for a direction in which an image does not change.
/// @param a, b CV_32FC1 of one size, 3 x 3 or more
double gradientCorrelation(const cv::Mat& a, const cv::Mat& b);

/// Of normally distributed values, the standard deviation in units of the median magnitude.
constexpr double kDeviationOfMedian = 1.4826;

/// The median of the values' magnitudes. @param values CV_32FC1, not empty
double medianMagnitude(const cv::Mat& values);

/// How far one image is a linear function of another one.
struct Agreement
{
  cv::Mat inliers;           ///< CV_8UC1: 255 where it is, 0 where something else is to be seen
  double share = 0.0;        ///< of the inliers
  double correlation = 0.0;  ///< over the inliers, -1..1; 0 if an image is constant there
};

/// Fits b = gain a + offset in least squares, again and again without the pixels whose residual is beyond three robust
/// standard deviations. @param a, b CV_32FC1 of one size, without an offset that is large beside their contrast
Agreement agreementOf(const cv::Mat& a, const cv::Mat& b);
}  // namespace xray_tracking
