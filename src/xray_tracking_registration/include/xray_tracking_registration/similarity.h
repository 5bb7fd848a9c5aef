#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// How alike an X-ray image and a DRR are. Larger is more alike. None depends on the images' scale and offset: both are
/// brought to mean 0 and standard deviation 1 first.
class Similarity
{
public:
  virtual ~Similarity() = default;

  /// @param xray, drr CV_32FC1 of one size, at least 5 x 5
  /// @return 0 if either image is constant
  /// @throws std::invalid_argument for images of another type or of two sizes
  double operator()(const cv::Mat& xray, const cv::Mat& drr) const;

private:
  /// @param xray, drr of mean 0 and standard deviation 1
  virtual double compare(const cv::Mat& xray, const cv::Mat& drr) const = 0;
};

/// Names that makeSimilarity knows:
/// - `normalised_mutual_information`: (H(A) + H(B)) / H(A, B) - 1 (Studholme, Pattern Recognition 32, 1999, less the 1
///   that it has for independent images). Joint histogram of 32 x 32 bins over each image's own range of +-3 standard
///   deviations (values beyond count at the border), every pixel shared among the 4 nearest bin centres by linear
///   weights;
/// - `gradient_correlation`: mean of the correlation coefficients of the horizontal and of the vertical Sobel gradients
///   (Penney, IEEE TMI 17(4), 1998).
/// @throws std::invalid_argument naming the similarity and those there are
std::unique_ptr<Similarity> makeSimilarity(const std::string& name);

/// The names, in the order above.
const std::vector<std::string>& similarityNames();
}  // namespace xray_tracking
