#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <random>
#include <vector>

#include <Eigen/LU>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Attenuation given in closed form, a sum of Gaussians: exposures of it at any displacement are exact, they owe
/// nothing to an interpolation.
class GaussianField
{
public:
  GaussianField(std::uint32_t seed, int count, double smallest_sigma, double largest_sigma, double amplitude,
                const cv::Size& size)
    : cells_(static_cast<int>(std::ceil(size.width / kCell)), static_cast<int>(std::ceil(size.height / kCell)))
  {
    std::mt19937 random(seed);
    const auto uniform = [&random](double low, double high)
    { return std::uniform_real_distribution<double>(low, high)(random); };
    for (int i = 0; i < count; ++i)
    {
      blobs_.push_back({ uniform(0, size.width), uniform(0, size.height), uniform(smallest_sigma, largest_sigma),
                         uniform(-amplitude, amplitude) });
    }
    for (int i = 0; i < cells_.width * cells_.height; ++i)
    {
      const double x = kCell * (i % cells_.width + 0.5), y = kCell * (i / cells_.width + 0.5);
      std::vector<Blob>& near = near_.emplace_back();
      std::copy_if(blobs_.begin(), blobs_.end(), std::back_inserter(near),
                   [&](const Blob& b)
                   { return std::hypot(x - b.x, y - b.y) < kCell + std::sqrt(2.0 * kFarthest) * b.sigma; });
    }
  }

  double operator()(double x, double y) const
  {
    const bool inside = x >= 0.0 && y >= 0.0 && x < kCell * cells_.width && y < kCell * cells_.height;
    const auto cell = inside ? static_cast<std::size_t>(y / kCell) * static_cast<std::size_t>(cells_.width) +
                                   static_cast<std::size_t>(x / kCell)
                             : 0;
    double sum = 0.0;
    for (const Blob& b : inside ? near_[cell] : blobs_)
    {
      const double dx = x - b.x, dy = y - b.y;
      const double squares = (dx * dx + dy * dy) / (2.0 * b.sigma * b.sigma);
      sum += squares < kFarthest ? b.amplitude * std::exp(-squares) : 0.0;
    }
    return sum;
  }

private:
  static constexpr double kCell = 16.0;      ///< [px]
  static constexpr double kFarthest = 20.0;  ///< squared distance, in 2 sigma squared, from which on a blob is zero
  struct Blob
  {
    double x, y, sigma, amplitude;
  };
  std::vector<Blob> blobs_;
  cv::Size cells_;
  std::vector<std::vector<Blob>> near_;  ///< of each cell, the blobs that are not zero all over it
};

/// How an exposure of 240 x 200 pixels differs from the plain one.
struct Exposure
{
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();          ///< of the target [px]
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();            ///< of the target, about kCentre
  Eigen::Vector2d overlay_displacement = Eigen::Vector2d::Zero();  ///< of what lies over it [px]
  double overlay = 0.0;                                            ///< its weight
  double gain = 1.0;
  double contrast = 1.0;
  double shading = 0.0;   ///< attenuation that slow shading adds at the image's corners
  cv::Rect cover;         ///< something with constant attenuation over the image
  double covering = 0.0;  ///< that attenuation
  double noise = 0.0;     ///< standard deviation of the relative, i.e. the attenuation's noise
  std::uint32_t seed = 0;
};

/// Of kRegion in the tests.
inline const Eigen::Vector2d kCentre(119.5, 99.5);

constexpr double kOffset = 100.0;
inline cv::Size exposureSize()
{
  return { 240, 200 };
}

inline const GaussianField& targetField()
{
  static const GaussianField field(3, 250, 2.5, 7.0, 0.3, exposureSize());
  return field;
}

/// @param counts behind nothing; @param type CV_16UC1 or CV_8UC1 (no offset then)
inline cv::Mat expose(const Exposure& e, double counts = 20000.0, int type = CV_16UC1)
{
  static const GaussianField overlay(7, 60, 12.0, 20.0, 0.3, exposureSize());
  std::mt19937 random(e.seed);
  std::normal_distribution<double> noise(0.0, e.noise > 0.0 ? e.noise : 1.0);
  cv::Mat values(exposureSize(), CV_64F);
  const Eigen::Matrix2d inverse = e.linear.inverse();
  for (int y = 0; y < values.rows; ++y)
  {
    for (int x = 0; x < values.cols; ++x)
    {
      const double u = 2.0 * x / values.cols - 1.0;
      const double v = 2.0 * y / values.rows - 1.0;
      const Eigen::Vector2d place = kCentre + inverse * (Eigen::Vector2d(x, y) - kCentre - e.displacement);
      double attenuation = e.contrast * targetField()(place.x(), place.y()) +
                           (e.cover.contains({ x, y }) ? e.covering : 0.0) +
                           e.shading * (u + 0.5 * v + u * v - v * v) / 3.0;
      if (e.overlay > 0.0)
      {
        attenuation += e.overlay * overlay(x - e.overlay_displacement.x(), y - e.overlay_displacement.y());
      }
      attenuation += e.noise > 0.0 ? noise(random) : 0.0;
      values.at<double>(y, x) = e.gain * counts * std::exp(-attenuation) + (type == CV_16UC1 ? kOffset : 0.0);
    }
  }
  cv::Mat image;
  values.convertTo(image, type);
  return image;
}

/// The Cramer-Rao bound [px] of a displacement from n points in a region with this noise in both images, from the
/// closed form's own gradients.
inline double displacementBound(const cv::Rect& region, int n, double noise)
{
  Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
  for (int y = region.y; y < region.br().y; ++y)
  {
    for (int x = region.x; x < region.br().x; ++x)
    {
      const GaussianField& f = targetField();
      const Eigen::Vector2d gradient(f(x + 0.01, y) - f(x - 0.01, y), f(x, y + 0.01) - f(x, y - 0.01));
      information += gradient * gradient.transpose() / (0.02 * 0.02) / region.area();
    }
  }
  return std::sqrt((2.0 * noise * noise / n * information.inverse()).trace());
}
}  // namespace xray_tracking
