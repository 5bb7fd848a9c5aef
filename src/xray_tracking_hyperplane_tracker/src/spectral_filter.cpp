#include "spectral_filter.h"

#include <algorithm>
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
  const cv::Size size = transformSize(image.size());
  cv::Mat spectrum;
  cv::copyMakeBorder(image, spectrum, 0, size.height - image.rows, 0, size.width - image.cols, cv::BORDER_REFLECT);
  cv::dct(spectrum, spectrum);
  constexpr int kBands = 48;
  const auto band = [&size](int u, int v)
  {
    const double f = std::hypot(static_cast<double>(u) / size.width, static_cast<double>(v) / size.height);
    return std::min(kBands - 1, static_cast<int>(f * kBands));
  };
  double power[kBands] = {};
  int count[kBands] = {};
  for (int v = 0; v < size.height; ++v)
  {
    for (int u = 0; u < size.width; ++u)
    {
      power[band(u, v)] += std::pow(static_cast<double>(spectrum.at<float>(v, u)), 2);
      ++count[band(u, v)];
    }
  }
  cv::Mat weights(size, CV_32F);
  for (int v = 0; v < size.height; ++v)
  {
    for (int u = 0; u < size.width; ++u)
    {
      const int b = band(u, v);
      const double f = 0.5 * std::hypot(static_cast<double>(u) / size.width, static_cast<double>(v) / size.height);
      weights.at<float>(v, u) =
          static_cast<float>(std::max(0.0, 1.0 - noise.power(f) * count[b] / std::max(power[b], 1e-30)));
    }
  }
  return filtered(image, weights);
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
      weights_.at<float>(v, u) =
          static_cast<float>(u + v > 2 ? 2.0 * variance / (noise + scale * overlay(u, v)) : 0.0);
    }
  }
}

cv::Mat Whitening::operator()(const cv::Mat& image) const
{
  return filtered(image, weights_);
}
}  // namespace xray_tracking
