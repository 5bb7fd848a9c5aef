#include "coarse_image.h"

#include <algorithm>
#include <cstdint>

namespace xray_tracking
{
namespace
{
constexpr int kGainOf8Bit = 256;

/// @tparam kBin bin's value, for loops that the compiler unrolls; 0: any
template <typename Pixel, int kBin>
void binRow(const cv::Mat& image, int row, int bin, int first, int count, std::uint32_t* sums, std::uint32_t gain,
            std::uint16_t* bins)
{
  const int width = bin * count;
  std::fill(sums, sums + width, 0u);
  for (int r = row * bin; r < (row + 1) * bin; ++r)
  {
    const Pixel* pixels = image.ptr<Pixel>(r) + static_cast<std::ptrdiff_t>(first) * bin;
    for (int c = 0; c < width; ++c)
    {
      sums[c] += pixels[c];
    }
  }
  const float scale = static_cast<float>(gain) / static_cast<float>(bin * bin);
  const int edge = kBin > 0 ? kBin : bin;
  for (int b = 0; b < count; ++b)
  {
    std::uint32_t sum = 0;
    for (int c = 0; c < edge; ++c)
    {
      sum += sums[b * edge + c];
    }
    bins[b] = static_cast<std::uint16_t>(scale * static_cast<float>(sum) + 0.5f);
  }
}

template <typename Pixel>
void binRow(const cv::Mat& image, int row, int bin, int first, int count, std::uint32_t* sums, std::uint32_t gain,
            std::uint16_t* bins)
{
  const auto binned = bin == 2 ? binRow<Pixel, 2> : bin == 4 ? binRow<Pixel, 4> : binRow<Pixel, 0>;
  binned(image, row, bin, first, count, sums, gain, bins);
}
}  // namespace

CoarseImage::CoarseImage(const cv::Mat& image, int bin)
  : bin_(bin), from_8_bit_(image.type() == CV_8UC1), size_(image.cols / bin, image.rows / bin)
{
  if (!isImageItself())
  {
    all_.create(size_, CV_16UC1);
    column_sums_.create(1, image.cols, CV_32SC1);
  }
}

void CoarseImage::update(const cv::Mat& image, const cv::Rect& part)
{
  if (isImageItself())
  {
    pixels_ = image;
    return;
  }
  const int left = std::clamp(part.x / bin_, 0, size_.width - 2);
  const int top = std::clamp(part.y / bin_, 0, size_.height - 2);
  const int right = std::clamp((part.br().x + bin_ - 1) / bin_, left + 2, size_.width);
  const int bottom = std::clamp((part.br().y + bin_ - 1) / bin_, top + 2, size_.height);
  pixels_ = all_(cv::Rect(left, top, right - left, bottom - top));
  auto* sums = reinterpret_cast<std::uint32_t*>(column_sums_.data);
  for (int row = top; row < bottom; ++row)
  {
    std::uint16_t* bins = pixels_.ptr<std::uint16_t>(row - top);
    if (from_8_bit_)
    {
      binRow<std::uint8_t>(image, row, bin_, left, right - left, sums, kGainOf8Bit, bins);
    }
    else
    {
      binRow<std::uint16_t>(image, row, bin_, left, right - left, sums, 1, bins);
    }
  }
}

PixelMap CoarseImage::toBins(const PixelMap& map) const
{
  cv::Size whole;
  cv::Point corner;
  pixels_.locateROI(whole, corner);
  const float scale = 1.f / static_cast<float>(bin_);
  const float half = 0.5f - 0.5f * scale;
  return { map.xx * scale, map.xy * scale, map.x0 * scale - half - static_cast<float>(corner.x),
           map.yx * scale, map.yy * scale, map.y0 * scale - half - static_cast<float>(corner.y) };
}

IntensityModel CoarseImage::intensity(const IntensityModel& of_image) const
{
  IntensityModel model = of_image;
  model.offset *= from_8_bit_ ? kGainOf8Bit : 1;
  return model;
}
}  // namespace xray_tracking
