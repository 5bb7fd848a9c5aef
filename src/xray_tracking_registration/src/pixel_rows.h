#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Numbers of every pixel side by side, as all that is done to derivatives is done to every one of them alike: one or
/// two vector registers a pixel. Row by row of the image.
constexpr int kPixelRow = 16;
using PixelRows = Eigen::Matrix<float, Eigen::Dynamic, kPixelRow, Eigen::RowMajor>;

/// Nearly a Gaussian, by three running means one after another: as many operations for any width. Beyond the image is
/// 0. After Gwosdek et al., Theoretical foundations of Gaussian convolution by extended box filtering, SSVM 2011: the
/// two outermost numbers count partly, so that the standard deviation is met.
class RunningBlur
{
public:
  /// @param sigma standard deviation [pixels], above 0
  explicit RunningBlur(double sigma);

  /// @param image CV_32FC1, continuous
  void operator()(cv::Mat& image) const;
  /// Takes the local means away from what counts.
  /// @param rows of an image, times what counts @param size of the image
  /// @param factors of the means, of the image, CV_32FC1, continuous: 0 for what does not count
  /// @param inner part of the image, 4 pixels wide at least
  /// @return of the inner part
  PixelRows withoutMeans(const PixelRows& rows, const cv::Size& size, const cv::Mat& factors,
                         const cv::Rect& inner) const;

private:
  std::size_t bufferSize(int width, int height) const;

  int reach_;     ///< of what counts wholly, to either side
  float edge_;    ///< weight of the next one
  float weight_;  ///< of the others
};

/// What a pixel's numbers are made of, of one image each, row by row.
struct RowParts
{
  const float* twists;         ///< six numbers a pixel
  const float* other_twists;   ///< further six, or null
  const float* by_saturation;  ///< what comes behind them
  const float* image;          ///< the last number
  const float* factors;        ///< of the twists
  const float* counts;         ///< factors of all
};
PixelRows makeRows(const RowParts& parts, int count);

/// Makes every number of a pixel its derivative of a normalised image from that of the image: what lies along the
/// image and along a constant is taken away. @param image mean 0, norm 1 over what counts
/// @param valid 1 for pixels that count, 0 for others, as rows and image have it
/// @param scale of the result
void projectOut(const Eigen::VectorXf& image, const Eigen::VectorXf& valid, float scale, PixelRows& rows);

/// Sums over the pixels: weight * row * row' and weight * difference * row.
struct WeighedSums
{
  Eigen::Matrix<double, kPixelRow, kPixelRow> squares = Eigen::Matrix<double, kPixelRow, kPixelRow>::Zero();
  Eigen::Matrix<double, kPixelRow, 1> products = Eigen::Matrix<double, kPixelRow, 1>::Zero();
};
WeighedSums weighedSums(const PixelRows& rows, const Eigen::VectorXf& weights, const Eigen::VectorXf& differences);
}  // namespace xray_tracking
