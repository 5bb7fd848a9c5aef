#include "image_similarity.h"

#include <algorithm>
#include <cmath>

namespace xray_tracking
{
namespace
{
/// Sums of two variables that give their correlation.
struct Moments
{
  double a = 0.0, b = 0.0, aa = 0.0, bb = 0.0, ab = 0.0;

  void add(float x, float y)
  {
    a += x;
    b += y;
    aa += static_cast<double>(x) * x;
    bb += static_cast<double>(y) * y;
    ab += static_cast<double>(x) * y;
  }
  double correlation(double count) const
  {
    const double variances = (aa - a * a / count) * (bb - b * b / count);
    return variances > 0.0 ? (ab - a * b / count) / std::sqrt(variances) : 0.0;
  }
};

/// sum p log p of what counts p sum to `total` make.
template <typename Counts>
double negativeEntropy(const Counts& counts, double total)
{
  double sum = 0.0;
  for (Eigen::Index i = 0; i < counts.size(); ++i)
  {
    const double p = counts(i) / total;
    sum += p > 0.0 ? p * std::log(p) : 0.0;
  }
  return sum;
}
}  // namespace

double NormalisedMutualInformation::operator()(const cv::Mat& a, const cv::Mat& b)
{
  const float last = static_cast<float>(bins() - 1);
  joint_.setZero();
  for (int y = 0; y < a.rows; ++y)
  {
    const float* row_a = a.ptr<float>(y);
    const float* row_b = b.ptr<float>(y);
    for (int x = 0; x < a.cols; ++x)
    {
      const int column = static_cast<int>(std::clamp(row_a[x], 0.f, last) + 0.5f);
      const float value = std::clamp(row_b[x], 0.f, last);
      const int row = std::min(static_cast<int>(value), bins() - 2);
      const float share = value - static_cast<float>(row);
      float* counts = &joint_(row, column);
      counts[0] += 1.f - share;
      counts[1] += share;
    }
  }
  const double total = static_cast<double>(a.total());
  const Eigen::ArrayXd of_a = joint_.cast<double>().colwise().sum();
  const Eigen::ArrayXd of_b = joint_.cast<double>().rowwise().sum();
  const double joint = negativeEntropy(Eigen::Map<const Eigen::ArrayXf>(joint_.data(), joint_.size()), total);
  return joint < 0.0 ? (negativeEntropy(of_a, total) + negativeEntropy(of_b, total)) / joint : 1.0;
}

double gradientCorrelation(const cv::Mat& a, const cv::Mat& b)
{
  Moments along_x, along_y;
  for (int y = 1; y < a.rows - 1; ++y)
  {
    const float *a0 = a.ptr<float>(y - 1), *a1 = a.ptr<float>(y), *a2 = a.ptr<float>(y + 1);
    const float *b0 = b.ptr<float>(y - 1), *b1 = b.ptr<float>(y), *b2 = b.ptr<float>(y + 1);
    for (int x = 1; x < a.cols - 1; ++x)
    {
      along_x.add(a1[x + 1] - a1[x - 1], b1[x + 1] - b1[x - 1]);
      along_y.add(a2[x] - a0[x], b2[x] - b0[x]);
    }
  }
  const double count = static_cast<double>((a.rows - 2) * (a.cols - 2));
  return 0.5 * (along_x.correlation(count) + along_y.correlation(count));
}

double medianMagnitude(const cv::Mat& values)
{
  std::vector<float> magnitudes(values.total());
  std::transform(values.begin<float>(), values.end<float>(), magnitudes.begin(), [](float v) { return std::abs(v); });
  const auto middle = magnitudes.begin() + static_cast<std::ptrdiff_t>(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  return *middle;
}

Agreement agreementOf(const cv::Mat& a, const cv::Mat& b)
{
  constexpr int kRounds = 5;
  constexpr double kOutlier = 3.0 * kDeviationOfMedian;
  constexpr double kRounding = 1e-3;
  Agreement agreement;
  // The first fit is without what is far off by itself.
  agreement.inliers = cv::abs(b) <= kOutlier * medianMagnitude(b);
  for (int round = 0;; ++round)
  {
    Moments moments;
    for (int y = 0; y < a.rows; ++y)
    {
      for (int x = 0; x < a.cols; ++x)
      {
        if (agreement.inliers.at<std::uint8_t>(y, x) != 0)
        {
          moments.add(a.at<float>(y, x), b.at<float>(y, x));
        }
      }
    }
    const double count = cv::countNonZero(agreement.inliers);
    agreement.share = count / static_cast<double>(a.total());
    agreement.correlation = moments.correlation(count);
    if (round == kRounds)
    {
      return agreement;
    }
    const double variance = moments.aa - moments.a * moments.a / count;
    const double gain = variance > 0.0 ? (moments.ab - moments.a * moments.b / count) / variance : 0.0;
    const cv::Mat residual = b - gain * a - (moments.b - gain * moments.a) / count;
    // Where the two are the same but for rounding, nothing is off.
    agreement.inliers =
        cv::abs(residual) <= std::max(kOutlier * medianMagnitude(residual), kRounding * medianMagnitude(b));
  }
}
}  // namespace xray_tracking
