#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
constexpr double kPeriod = 48.0;
inline const cv::Size kSize(260, 420);
/// The fifth vertebra.
inline const cv::Rect kRegion(80, 170, 100, 72);

/// A column of nine vertebrae, each a sum of the same Gaussians whose sizes differ by `individuality`.
class SpineField
{
public:
  explicit SpineField(double individuality)
  {
    std::mt19937 random(8);
    const auto uniform = [&random](double low, double high)
    { return std::uniform_real_distribution<double>(low, high)(random); };
    std::vector<Blob> vertebra(14);
    for (Blob& blob : vertebra)
    {
      blob = { uniform(95.0, 165.0), uniform(0.0, kPeriod), uniform(3.0, 7.0), uniform(-0.2, 0.4) };
    }
    for (int v = 0; v < 9; ++v)
    {
      for (Blob blob : vertebra)
      {
        blob.y += (v - 0.1) * kPeriod;
        blob.amplitude *= 1.0 + individuality * uniform(-1.0, 1.0);
        blobs_.push_back(blob);
      }
    }
  }

  /// @param noise standard deviation of attenuation
  cv::Mat expose(const Eigen::Vector2d& displacement, double noise, std::uint32_t seed) const
  {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    cv::Mat image(kSize, CV_16UC1);
    for (int y = 0; y < image.rows; ++y)
    {
      for (int x = 0; x < image.cols; ++x)
      {
        double attenuation = noise * normal(random);
        for (const Blob& b : blobs_)
        {
          const double dx = (x - displacement.x() - b.x) / b.sigma, dy = (y - displacement.y() - b.y) / b.sigma;
          const double squares = 0.5 * (dx * dx + dy * dy);
          attenuation += squares < 15.0 ? b.amplitude * std::exp(-squares) : 0.0;
        }
        image.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(20000.0 * std::exp(-attenuation));
      }
    }
    return image;
  }

private:
  struct Blob
  {
    double x, y, sigma, amplitude;
  };
  std::vector<Blob> blobs_;
};
}  // namespace xray_tracking
