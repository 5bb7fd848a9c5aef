#include "noise_spectrum.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "point_sampler.h"

namespace xray_tracking
{
namespace
{
constexpr int kBlock = 16;
constexpr int kBlockStep = 8;
/// Below, structure counts as such [cycles / px].
constexpr double kSlow = 0.17;
/// Of |N(0, 1)|.
constexpr double kMedian = 0.6745;
/// Share of an image's pixels at its greatest or smallest value that makes a plateau.
constexpr double kPlateau = 1e-3;
/// Pixels a grey value, from which on gaps between the values are no chance.
constexpr int kCrowded = 30;

double medianOf(std::vector<float>& values)
{
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return static_cast<double>(*middle);
}
}  // namespace

NoiseSpectrum::NoiseSpectrum(const cv::Mat& values, const cv::Mat& usable, double least)
{
  // A Hann window, as a slope that ends at the block's border would be seen in all frequencies; and what it makes of
  // the variance of a transform's coefficient along one axis.
  cv::Mat window(kBlock, kBlock, CV_32F);
  double gain[kBlock];
  for (int u = 0; u < kBlock; ++u)
  {
    const auto raised = [](int i) { return std::pow(std::sin(M_PI * (i + 0.5) / kBlock), 2); };
    gain[u] = 0.0;
    for (int i = 0; i < kBlock; ++i)
    {
      const double basis = std::sqrt((u == 0 ? 1.0 : 2.0) / kBlock) * std::cos(M_PI * (i + 0.5) * u / kBlock);
      gain[u] += std::pow(raised(i) * basis, 2);
      window.at<float>(i, u) = static_cast<float>(raised(i) * raised(u));
    }
  }
  std::array<std::vector<float>, kBands> magnitudes;
  cv::Mat windowed, coefficients;
  for (int y = 0; y + kBlock <= values.rows; y += kBlockStep)
  {
    for (int x = 0; x + kBlock <= values.cols; x += kBlockStep)
    {
      const cv::Rect block(x, y, kBlock, kBlock);
      if (cv::countNonZero(usable(block)) < block.area())
      {
        continue;
      }
      cv::subtract(values(block), cv::mean(values(block)), windowed);
      cv::dct(windowed.mul(window), coefficients);
      for (int v = 0; v < kBlock; ++v)
      {
        for (int u = 0; u < kBlock; ++u)
        {
          const double f = std::hypot(u, v) / (2.0 * kBlock);
          const float magnitude =
              std::abs(coefficients.at<float>(v, u)) / static_cast<float>(std::sqrt(gain[u] * gain[v]));
          if (f >= kSlow && magnitude > 0.f)
          {
            magnitudes[static_cast<std::size_t>(f / kBandWidth + 0.5)].push_back(magnitude);
          }
        }
      }
    }
  }
  power_.fill(-1.0);
  for (std::size_t band = 0; band < power_.size(); ++band)
  {
    if (!magnitudes[band].empty())
    {
      power_[band] = std::max(least, std::pow(medianOf(magnitudes[band]) / kMedian, 2));
    }
  }
  // Bands without an answer are as the next one that has one.
  const auto answered = [](double power) { return power >= 0.0; };
  const auto first = std::find_if(power_.begin(), power_.end(), answered);
  if (first == power_.end())
  {
    power_.fill(least);
    return;
  }
  std::fill(power_.begin(), first, *first);
  for (std::size_t band = 1; band < power_.size(); ++band)
  {
    power_[band] = power_[band] >= 0.0 ? power_[band] : power_[band - 1];
  }
}

double NoiseSpectrum::power(double f) const
{
  const double place = std::clamp(f / kBandWidth, 0.0, kBands - 1.0);
  const auto before = static_cast<std::size_t>(std::min(place, kBands - 2.0));
  const double part = place - static_cast<double>(before);
  return power_[before] + part * (power_[before + 1] - power_[before]);
}

double NoiseSpectrum::foldedPower(double u, double v, int step) const
{
  // Of all that fold onto it, the frequencies up to a half.
  const auto unfolded = [step](double f, int k) { return (k % 2 == 0 ? k / 2 + f : (k + 1) / 2 - f) / step; };
  double sum = 0.0;
  for (int i = 0; i < step; ++i)
  {
    for (int j = 0; j < step; ++j)
    {
      sum += power(std::hypot(unfolded(u, i), unfolded(v, j)));
    }
  }
  return sum / (step * step);
}

double NoiseSpectrum::varianceOfMeans(int edge) const
{
  const auto gain = [edge](double f) { return std::sin(M_PI * f * edge) / (edge * std::sin(M_PI * f)); };
  return variance([&gain](double u, double v) { return gain(u) * gain(v); });
}

cv::Mat unsaturated(const cv::Mat& image, const cv::Rect& part, const IntensityModel& intensity)
{
  const double full_scale = image.depth() == CV_8U ? 255.0 : 65535.0;
  const double count = static_cast<double>(image.total());
  double least, greatest;
  cv::minMaxLoc(image, &least, &greatest);
  const auto is_plateau = [&](double value) { return cv::countNonZero(image == value) > kPlateau * count; };
  const cv::Mat pixels = image(part);
  cv::Mat usable(pixels.size(), CV_8UC1, cv::Scalar(255));
  usable.setTo(0, pixels >= (is_plateau(greatest) ? greatest : full_scale));
  if (is_plateau(least))
  {
    usable.setTo(0, pixels <= least);
  }
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    usable.setTo(0, pixels <= intensity.offset + 1.0);
  }
  return usable;
}

double greyStep(const cv::Mat& image)
{
  std::vector<int> counts(image.depth() == CV_8U ? 256 : 65536, 0);
  for (int row = 0; row < image.rows; ++row)
  {
    for (int column = 0; column < image.cols; ++column)
    {
      const int value =
          image.depth() == CV_8U ? image.at<std::uint8_t>(row, column) : image.at<std::uint16_t>(row, column);
      ++counts[static_cast<std::size_t>(value)];
    }
  }
  const auto seen = [](int n) { return n > 0; };
  const auto values = std::count_if(counts.begin(), counts.end(), seen);
  const auto first = std::find_if(counts.begin(), counts.end(), seen);
  const auto last = std::find_if(counts.rbegin(), counts.rend(), seen).base() - 1;
  const bool crowded = values > 1 && static_cast<double>(image.total()) >= static_cast<double>(kCrowded) * values;
  return crowded ? std::max(1.0, static_cast<double>(last - first) / static_cast<double>(values - 1)) : 1.0;
}
}  // namespace xray_tracking
