#include "xray_tracking_detector_simulator/image_formation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <opencv2/core/hal/hal.hpp>
#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr int kBlock = 512;         // pixels of a row that are worked on at a time, on the stack
constexpr int kScatterBinning = 8;  // scatter is smooth: it is computed on a grid as coarse as this [px]

/// What random numbers are for.
enum Purpose : std::uint64_t
{
  QUANTA,
  ELECTRONICS,
  GAIN,
  OFFSET
};

template <typename Function>
void forEachRowBlock(const cv::Size& size, const Function& function)
{
  tbb::parallel_for(tbb::blocked_range<int>(0, size.height, 16),
                    [&](const tbb::blocked_range<int>& rows)
                    {
                      for (int row = rows.begin(); row != rows.end(); ++row)
                      {
                        for (int column = 0; column < size.width; column += kBlock)
                        {
                          function(row, column, std::min(kBlock, size.width - column));
                        }
                      }
                    });
}

/// The numbers of one block of one row.
RandomStream blockStream(const RandomStream& stream, int row, int column)
{
  return stream.part(static_cast<std::uint64_t>(row)).part(static_cast<std::uint64_t>(column));
}

/// A slow change over the exposures within -1 .. 1: two waves of 20 to 80 exposures with periods and phases at random.
double drift(const RandomStream& stream, int exposure)
{
  double sum = 0.0;
  for (std::uint64_t wave = 0; wave < 2; ++wave)
  {
    const double period = 20.0 + 60.0 * stream.uniform(2 * wave);
    sum += 0.5 * std::sin(2.0 * CV_PI * (exposure / period + stream.uniform(2 * wave + 1)));
  }
  return sum;
}
}  // namespace

void ImageFormationOptions::validate() const
{
  requireInRange("image/scatter_fraction", scatter_fraction, 0.0, 1.0);
  requireInRange("image/scatter_sigma_px", scatter_sigma_px, kScatterBinning, 1000.0);
  requireInRange("image/blur_sigma_px", blur_sigma_px, 0.0, 20.0);
  requireInRange("image/air_quanta", air_quanta, 0.0, 1e9);
  requireInRange("image/electronic_noise", electronic_noise, 0.0, 1e4);
  requireInRange("image/gain_drift", gain_drift, 0.0, 0.5);
  requireInRange("image/offset_drift", offset_drift, 0.0, 1e4);
  requireInRange("image/bits", bits, 14, 16);
}

ImageFormation::ImageFormation(const ImageFormationOptions& options, const IntensityModel& intensity,
                               std::uint64_t seed)
  : options_(options),
    beam_(options.polychromatic ? filteredBeam() : monochromaticBeam()),
    offset_(intensity.offset),
    stream_(seed)
{
  options.validate();
  if (intensity.kind != IntensityModel::Kind::COUNTS)
  {
    throw std::invalid_argument("intensity.kind is attenuation, expected counts: that is what a detector reads out");
  }
  if (!intensity.air_counts)
  {
    throw std::invalid_argument("intensity.air_counts is absent, expected the counts behind air alone");
  }
  constexpr double kMost = 65535.0;
  requireInRange("intensity.offset", intensity.offset, 0.0, kMost);
  requireInRange("intensity.air_counts", *intensity.air_counts, intensity.offset + 1.0, kMost);
  air_signal_ = *intensity.air_counts - intensity.offset;
}

void ImageFormation::form(const cv::Mat& soft, const cv::Mat& bone, int detector, int exposure, cv::Mat& counts)
{
  CV_Assert(soft.type() == CV_32FC1 && bone.type() == CV_32FC1 && soft.size() == bone.size());
  const RandomStream of_detector = stream_.part(static_cast<std::uint64_t>(detector));
  const auto of_exposure = [&](Purpose purpose)
  { return of_detector.part(purpose).part(static_cast<std::uint64_t>(exposure)); };

  computePrimary(soft, bone);
  if (options_.scatter_fraction > 0.0)
  {
    addScatter();
  }
  if (options_.air_quanta > 0.0)
  {
    addQuantumNoise(of_exposure(QUANTA));
  }
  if (options_.blur_sigma_px > 0.0)
  {
    cv::GaussianBlur(signal_, signal_, cv::Size(), options_.blur_sigma_px);
  }
  const double gain = air_signal_ * (1.0 + options_.gain_drift * drift(of_detector.part(GAIN), exposure));
  const double offset = offset_ + options_.offset_drift * drift(of_detector.part(OFFSET), exposure);
  readOut(of_exposure(ELECTRONICS), gain, offset, counts);
}

void ImageFormation::computePrimary(const cv::Mat& soft, const cv::Mat& bone)
{
  signal_.create(soft.size(), CV_32FC1);
  forEachRowBlock(soft.size(),
                  [&](int row, int column, int count)
                  {
                    const float* soft_length = soft.ptr<float>(row) + column;
                    const float* bone_length = bone.ptr<float>(row) + column;
                    float* primary = signal_.ptr<float>(row) + column;
                    std::array<float, kBlock> exponent;
                    std::fill_n(primary, count, 0.0F);
                    for (const SpectralLine& line : beam_)
                    {
                      const auto mu_soft = static_cast<float>(-line.soft);
                      const auto mu_bone = static_cast<float>(-line.bone);
                      const auto weight = static_cast<float>(line.weight);
                      for (int i = 0; i < count; ++i)
                      {
                        exponent[i] = mu_soft * soft_length[i] + mu_bone * bone_length[i];
                      }
                      cv::hal::exp32f(exponent.data(), exponent.data(), count);
                      for (int i = 0; i < count; ++i)
                      {
                        primary[i] += weight * exponent[i];
                      }
                    }
                  });
}

void ImageFormation::addScatter()
{
  cv::multiply(signal_, signal_, scatter_);
  cv::subtract(signal_, scatter_, scatter_);
  const cv::Size small((signal_.cols + kScatterBinning - 1) / kScatterBinning,
                       (signal_.rows + kScatterBinning - 1) / kScatterBinning);
  cv::resize(scatter_, small_scatter_, small, 0.0, 0.0, cv::INTER_AREA);
  // The object goes on beyond the panel: its edge is replicated.
  cv::GaussianBlur(small_scatter_, small_scatter_, cv::Size(), options_.scatter_sigma_px / kScatterBinning, 0.0,
                   cv::BORDER_REPLICATE);
  cv::resize(small_scatter_, scatter_, signal_.size(), 0.0, 0.0, cv::INTER_LINEAR);
  cv::scaleAdd(scatter_, options_.scatter_fraction, signal_, signal_);
}

void ImageFormation::addQuantumNoise(const RandomStream& stream)
{
  const auto quanta = static_cast<float>(options_.air_quanta);
  forEachRowBlock(signal_.size(),
                  [&](int row, int column, int count)
                  {
                    float* signal = signal_.ptr<float>(row) + column;
                    std::array<float, kBlock> normal;
                    blockStream(stream, row, column).fillNormal(normal.data(), count);
                    for (int i = 0; i < count; ++i)
                    {
                      signal[i] = poissonFromNormal(quanta * signal[i], normal[i]) / quanta;
                    }
                  });
}

void ImageFormation::readOut(const RandomStream& stream, double gain, double offset, cv::Mat& counts) const
{
  counts.create(signal_.size(), CV_16UC1);
  const auto scale = static_cast<float>(gain);
  // Half a count for rounding by truncation: values are not negative after clipping.
  const auto shift = static_cast<float>(offset + 0.5);
  const auto noise = static_cast<float>(options_.electronic_noise);
  const auto most = static_cast<float>((1 << options_.bits) - 1);
  forEachRowBlock(signal_.size(),
                  [&](int row, int column, int count)
                  {
                    const float* signal = signal_.ptr<float>(row) + column;
                    auto* out = counts.ptr<std::uint16_t>(row) + column;
                    std::array<float, kBlock> normal;
                    if (noise > 0.0F)
                    {
                      blockStream(stream, row, column).fillNormal(normal.data(), count);
                    }
                    else
                    {
                      std::fill_n(normal.data(), count, 0.0F);
                    }
                    for (int i = 0; i < count; ++i)
                    {
                      const float value = shift + scale * signal[i] + noise * normal[i];
                      out[i] = static_cast<std::uint16_t>(std::min(std::max(value, 0.0F), most));
                    }
                  });
}
}  // namespace xray_tracking
