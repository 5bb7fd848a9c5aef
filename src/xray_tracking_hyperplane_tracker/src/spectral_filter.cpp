#include "spectral_filter.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Core>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
/// A size of the same parity as the cosine transform wants it, and quick.
cv::Size transformSize(const cv::Size& size)
{
  return { 2 * cv::getOptimalDFTSize((size.width + 1) / 2), 2 * cv::getOptimalDFTSize((size.height + 1) / 2) };
}

/// What has no more power than so many times the noise in a band of a block is taken for noise. Some bands have few
/// coefficients, and noise is not the same everywhere: in attenuation it is greater behind what is dense. (1 lets
/// through so much that knee_real's fit does not converge; from 2 to 6 little changes there, on wrist_real and the
/// thorax.)
constexpr double kDoubtful = 4.0;

/// Multiplies an image's cosine transform by weights of the transform's size.
cv::Mat filtered(const cv::Mat& image, const cv::Mat& weights)
{
  cv::Mat work;
  cv::copyMakeBorder(image, work, 0, weights.rows - image.rows, 0, weights.cols - image.cols, cv::BORDER_REFLECT);
  cv::dct(work, work);
  work = work.mul(weights);
  cv::idct(work, work);
  return work(cv::Rect(cv::Point(), image.size()));
}
}  // namespace

cv::Mat withoutNoise(const cv::Mat& image, const NoiseSpectrum& noise)
{
  constexpr int kBlock = 16;
  constexpr int kStep = kBlock / 4;
  constexpr int kMargin = kBlock - kStep;  // every pixel is in as many blocks
  constexpr std::size_t kBands = 24;
  std::array<std::size_t, kBlock * kBlock> band;
  std::array<double, kBands> expected{};
  cv::Mat window(kBlock, kBlock, CV_32F);  // those of overlapping blocks add up to one
  for (int v = 0; v < kBlock; ++v)
  {
    for (int u = 0; u < kBlock; ++u)
    {
      const std::size_t b = static_cast<std::size_t>(std::hypot(u, v) + 0.5);
      band[static_cast<std::size_t>(v * kBlock + u)] = b;
      expected[b] += noise.power(std::hypot(u, v) / (2.0 * kBlock));
      const auto raised = [](int i) { return std::pow(std::sin(M_PI * (i + 0.5) / kBlock), 2); };
      window.at<float>(v, u) = static_cast<float>(0.25 * raised(u) * raised(v));
    }
  }

  cv::Mat padded, block, coefficients;
  const auto up = [](int size) { return (size + kStep - 1) / kStep * kStep - size; };
  cv::copyMakeBorder(image, padded, kMargin, kMargin + up(image.rows), kMargin, kMargin + up(image.cols),
                     cv::BORDER_REFLECT);
  cv::Mat sum(padded.size(), CV_32F, cv::Scalar(0.0));
  for (int y = 0; y + kBlock <= padded.rows; y += kStep)
  {
    for (int x = 0; x + kBlock <= padded.cols; x += kStep)
    {
      const cv::Rect place(x, y, kBlock, kBlock);
      cv::dct(padded(place), coefficients);
      float* c = coefficients.ptr<float>();
      std::array<double, kBands> power{};
      for (std::size_t i = 0; i < band.size(); ++i)
      {
        power[band[i]] += std::pow(static_cast<double>(c[i]), 2);
      }
      for (std::size_t i = 1; i < band.size(); ++i)
      {
        c[i] *=
            static_cast<float>(std::max(0.0, 1.0 - kDoubtful * expected[band[i]] / std::max(power[band[i]], 1e-30)));
      }
      cv::idct(coefficients, block);
      sum(place) += block.mul(window);
    }
  }
  return sum(cv::Rect(cv::Point(kMargin, kMargin), image.size())).clone();
}

Whitening::Whitening(const cv::Size& grid, int step, const DifferenceModel& model)
{
  const cv::Size size = transformSize(grid);
  weights_.create(size, CV_32F);
  const auto frequency = [&size](int u, int v)
  { return Eigen::Vector2d(static_cast<double>(u) / size.width, static_cast<double>(v) / size.height); };
  const auto overlay = [&frequency](int u, int v)
  { return u + v > 2 ? std::pow(frequency(u, v).norm(), -3) : 0.0; };  // below: shading
  double sum = 0.0;
  for (int v = 0; v < size.height; ++v)
  {
    for (int u = 0; u < size.width; ++u)
    {
      sum += overlay(u, v);
    }
  }
  const double scale = model.background / (sum / size.area());
  const double variance = model.noise.variance();
  for (int v = 0; v < size.height; ++v)
  {
    for (int u = 0; u < size.width; ++u)
    {
      const Eigen::Vector2d f = 0.5 * frequency(u, v);
      const double noise = 2.0 * model.noise.foldedPower(f.x(), f.y(), step);  // both images have it
      weights_.at<float>(v, u) = static_cast<float>(u + v > 2 ? 2.0 * variance / (noise + scale * overlay(u, v)) : 0.0);
    }
  }
}

cv::Mat Whitening::operator()(const cv::Mat& image) const
{
  return filtered(image, weights_);
}
}  // namespace xray_tracking
