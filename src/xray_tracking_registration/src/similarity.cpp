#include "xray_tracking_registration/similarity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr int kMinEdge = 5;

/// @return false for a constant image
bool standardise(const cv::Mat& image, cv::Mat& standard)
{
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(image, mean, deviation);
  // Rounding alone gives a constant float image a deviation of about 1e-7 of its mean.
  if (!(deviation[0] > 1e-6 * std::abs(mean[0])))
  {
    return false;
  }
  image.convertTo(standard, CV_32F, 1.0 / deviation[0], -mean[0] / deviation[0]);
  return true;
}

double correlation(const cv::Mat& a, const cv::Mat& b)
{
  const cv::Mat a0 = a - cv::mean(a);
  const cv::Mat b0 = b - cv::mean(b);
  const double norm = cv::norm(a0) * cv::norm(b0);
  return norm > 0.0 ? a0.dot(b0) / norm : 0.0;
}

struct Gradients
{
  explicit Gradients(const cv::Mat& image)
  {
    cv::Sobel(image, u, CV_32F, 1, 0, 3, 0.125, 0.0, cv::BORDER_REFLECT);
    cv::Sobel(image, v, CV_32F, 0, 1, 3, 0.125, 0.0, cv::BORDER_REFLECT);
  }
  cv::Mat u;
  cv::Mat v;
};

class NormalisedMutualInformation : public Similarity
{
  static constexpr int kBins = 32;
  static constexpr float kRange = 3.0f;

  double compare(const cv::Mat& xray, const cv::Mat& drr) const override
  {
    std::array<double, kBins * kBins> joint{};
    for (int row = 0; row < xray.rows; ++row)
    {
      const float* a = xray.ptr<float>(row);
      const float* b = drr.ptr<float>(row);
      for (int column = 0; column < xray.cols; ++column)
      {
        const Bin at = bin(a[column]);
        const Bin bt = bin(b[column]);
        double* cell = &joint[at.index * kBins + bt.index];
        cell[0] += (1.0f - at.share) * (1.0f - bt.share);
        cell[1] += (1.0f - at.share) * bt.share;
        cell[kBins] += at.share * (1.0f - bt.share);
        cell[kBins + 1] += at.share * bt.share;
      }
    }
    std::array<double, kBins> rows{};
    std::array<double, kBins> columns{};
    for (int i = 0; i < kBins; ++i)
    {
      for (int j = 0; j < kBins; ++j)
      {
        rows[i] += joint[i * kBins + j];
        columns[j] += joint[i * kBins + j];
      }
    }
    const auto count = static_cast<double>(xray.total());
    const double both = entropy(joint, count);
    return both > 0.0 ? (entropy(rows, count) + entropy(columns, count)) / both - 1.0 : 0.0;
  }

  struct Bin
  {
    int index;    ///< lower of the two bins
    float share;  ///< of the upper one
  };

  static Bin bin(float value)
  {
    const float place = std::clamp((value + kRange) * ((kBins - 1) / (2.0f * kRange)), 0.0f, kBins - 1.0f);
    const int index = std::min(static_cast<int>(place), kBins - 2);
    return { index, place - static_cast<float>(index) };
  }

  template <typename Histogram>
  static double entropy(const Histogram& histogram, double count)
  {
    double sum = 0.0;
    for (const double n : histogram)
    {
      if (n > 0.0)
      {
        sum -= n / count * std::log(n / count);
      }
    }
    return sum;
  }
};

class GradientCorrelation : public Similarity
{
  double compare(const cv::Mat& xray, const cv::Mat& drr) const override
  {
    const Gradients a(xray);
    const Gradients b(drr);
    return 0.5 * (correlation(a.u, b.u) + correlation(a.v, b.v));
  }
};
}  // namespace

double Similarity::operator()(const cv::Mat& xray, const cv::Mat& drr) const
{
  if (xray.type() != CV_32FC1 || drr.type() != CV_32FC1 || xray.size() != drr.size() || xray.rows < kMinEdge ||
      xray.cols < kMinEdge)
  {
    throw std::invalid_argument("similarity: expected two float images of one size, at least 5 x 5 pixels");
  }
  cv::Mat a;
  cv::Mat b;
  return standardise(xray, a) && standardise(drr, b) ? compare(a, b) : 0.0;
}

std::unique_ptr<Similarity> makeSimilarity(const std::string& name)
{
  if (name == "normalised_mutual_information")
  {
    return std::make_unique<NormalisedMutualInformation>();
  }
  if (name == "gradient_correlation")
  {
    return std::make_unique<GradientCorrelation>();
  }
  std::string known;
  for (const std::string& other : similarityNames())
  {
    known += (known.empty() ? "" : ", ") + other;
  }
  throw std::invalid_argument("similarity is '" + name + "': expected one of " + known);
}

const std::vector<std::string>& similarityNames()
{
  static const std::vector<std::string> names{ "normalised_mutual_information", "gradient_correlation" };
  return names;
}
}  // namespace xray_tracking
