#pragma once

#include <cmath>
#include <functional>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
constexpr int kSize = 512;
constexpr double kOffset = 100.0;
constexpr double kAir = 20000.0;
const IntensityModel kCounts{ IntensityModel::Kind::COUNTS, kOffset, {} };

/// Tells of a pixel whether it is; also between pixels.
using Shape = std::function<bool(double x, double y)>;

/// An exposure of a trunk with a spine, and air on the right; quanta, an electronic noise of 5 counts, a detector's
/// blur.
class Scene
{
public:
  explicit Scene(int size = kSize) : light_(size, size, CV_32FC1), scale_(double(size) / kSize)
  {
    for (int y = 0; y < size; ++y)
    {
      for (int x = 0; x < size; ++x)
      {
        light_.at<float>(y, x) = static_cast<float>(std::exp(-attenuation(x / scale_, y / scale_)));
      }
    }
  }
  /// What is behind a shape gets less light.
  Scene& cover(const Shape& shape, double transmission)
  {
    for (int y = 0; y < light_.rows; ++y)
    {
      for (int x = 0; x < light_.cols; ++x)
      {
        light_.at<float>(y, x) *= shape(x / scale_, y / scale_) ? static_cast<float>(transmission) : 1.f;
      }
    }
    return *this;
  }
  /// @param ratio of what is scattered widely to what is not
  Scene& scatter(double ratio)
  {
    scatter_ = ratio;
    return *this;
  }
  /// @param dose counts of air; @param blur standard deviation [px]; @param quantum counts a quantum, 0: no noise
  cv::Mat expose(double dose = kAir, double quantum = 4.0, std::uint64_t seed = 1, double blur = 0.8) const
  {
    cv::Mat counts = dose * light_;
    cv::Mat scatter;
    cv::resize(counts, scatter, { 64, 64 }, 0, 0, cv::INTER_AREA);
    cv::GaussianBlur(scatter, scatter, {}, 6.0, 0.0, cv::BORDER_CONSTANT);
    cv::resize(scatter, scatter, counts.size());
    cv::GaussianBlur(counts, counts, {}, blur);
    counts += scatter_ * scatter;
    cv::Mat noise(counts.size(), CV_32FC1), variance = quantum * counts + (quantum > 0.0 ? 25.0 : 0.0);
    cv::RNG(seed).fill(noise, cv::RNG::NORMAL, 0, 1);
    cv::sqrt(variance, variance);
    counts += noise.mul(variance) + kOffset;
    cv::Mat image;
    counts.convertTo(image, CV_16U);
    return image;
  }

private:
  static double attenuation(double x, double y)
  {
    // Chords of a trunk, and of vertebrae whose edges are as sharp as they come.
    const double r = (x - 200.0) / 260.0;
    double chord = r * r < 1.0 ? 4.5 * std::sqrt(1.0 - r * r) : 0.0;
    const double v = std::fmod(y + 20.0, 90.0);
    chord += std::abs(x - 230.0 - 20.0 * std::sin(y / 90.0)) < 45.0 && v < 72.0 ? 0.8 : 0.0;
    return chord + 0.15 * std::sin(x / 23.0) * std::sin(y / 31.0);
  }
  cv::Mat light_;
  double scale_;
  double scatter_ = 0.0;
};
}  // namespace xray_tracking
