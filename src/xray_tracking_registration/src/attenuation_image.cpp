#include "xray_tracking_registration/attenuation_image.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numeric>
#include <stdexcept>
#include <string>

#include "xray_tracking_core/several_processors.h"

#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
namespace
{
/// One logarithm, that of the product, does for as many 16 bit counts as have a product below the largest float.
constexpr int kFactors = 7;

FOR_SEVERAL_PROCESSORS void toFloats(const std::uint8_t* from, int count, float* to)
{
  for (int n = 0; n < count; ++n)
  {
    to[n] = from[n];
  }
}

FOR_SEVERAL_PROCESSORS void toFloats(const std::uint16_t* from, int count, float* to)
{
  for (int n = 0; n < count; ++n)
  {
    to[n] = from[n];
  }
}

/// Products with counts above an offset, 1 at least.
FOR_SEVERAL_PROCESSORS void multiply(const float* values, float offset, int count, float* products)
{
  for (int n = 0; n < count; ++n)
  {
    const float above = values[n] - offset;
    products[n] *= above > 1.0f ? above : 1.0f;
  }
}

/// Puts `neutral` where a pixel is not used, and counts those that are.
FOR_SEVERAL_PROCESSORS void leaveOut(const std::uint8_t* used, int count, float neutral, float* values, float* counts)
{
  for (int n = 0; n < count; ++n)
  {
    const float share = used[n] != 0 ? 1.0f : 0.0f;
    values[n] = share * values[n] + (1.0f - share) * neutral;
    counts[n] += share;
  }
}
}  // namespace

AttenuationImage::AttenuationImage(const cv::Mat& image, const IntensityModel& intensity)
  : image_(image), counts_(intensity.kind == IntensityModel::Kind::COUNTS)
{
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_16UC1 && image.type() != CV_32FC1))
  {
    throw std::invalid_argument("image: expected one channel of 8 or 16 bit without sign or of float, not empty");
  }
  if (!cv::checkRange(image))
  {
    throw std::invalid_argument("image: has values that are not finite");
  }
  if (!counts_)
  {
    return;
  }
  most_factors_ = image.depth() == CV_32F ? 1 : kFactors;
  offset_ = intensity.offset;
  air_ = airCounts(image, intensity);
  if (!(air_ > offset_))
  {
    throw std::invalid_argument("intensity: air counts are " + std::to_string(air_) +
                                ": expected more than the offset " + std::to_string(offset_));
  }
}

AttenuationBins AttenuationImage::bins(const cv::Rect& bins, int edge, const cv::Mat& usable) const
{
  const cv::Rect pixels(bins.tl() * edge, bins.size() * edge);
  const int width = pixels.width;
  const bool all = usable.empty() || cv::countNonZero(usable(pixels)) == pixels.area();
  const auto offset = static_cast<float>(offset_);
  const float neutral = counts_ ? offset + 1.0f : 0.0f;
  const auto air = static_cast<float>(counts_ ? std::log(air_ - offset_) : 0.0);
  AttenuationBins result{ cv::Mat(bins.size(), CV_32FC1), all ? cv::Mat() : cv::Mat(bins.size(), CV_32FC1) };
  std::vector<float> values(width);
  std::vector<float> products(width);
  std::vector<float> sums(width);                              // of the pixels one below the other
  std::vector<float> counts(width, static_cast<float>(edge));  // of those that are used
  for (int row = 0; row < bins.height; ++row)
  {
    std::fill(sums.begin(), sums.end(), 0.0f);
    if (!all)
    {
      std::fill(counts.begin(), counts.end(), 0.0f);
    }
    int factors = 0;
    for (int y = 0; y < edge; ++y)
    {
      const int line = pixels.y + row * edge + y;
      readLine(line, pixels.x, values);
      if (!all)
      {
        leaveOut(usable.ptr<std::uint8_t>(line) + pixels.x, width, neutral, values.data(), counts.data());
      }
      if (!counts_)
      {
        std::transform(values.begin(), values.end(), sums.begin(), sums.begin(), std::plus<>());
        continue;
      }
      if (factors == 0)
      {
        std::fill(products.begin(), products.end(), 1.0f);
      }
      multiply(values.data(), offset, width, products.data());
      if (++factors == most_factors_ || y + 1 == edge)
      {
        cv::log(products, products);
        std::transform(products.begin(), products.end(), sums.begin(), sums.begin(), std::plus<>());
        factors = 0;
      }
    }
    float* mean = result.mean.ptr<float>(row);
    for (int bin = 0; bin < bins.width; ++bin)
    {
      const auto sum = [&](const std::vector<float>& of)
      { return std::accumulate(of.begin() + bin * edge, of.begin() + (bin + 1) * edge, 0.0f); };
      const float count = sum(counts);
      const float average = sum(sums) / std::max(count, 1.0f);
      mean[bin] = counts_ ? (count > 0.0f ? air - average : 0.0f) : average;
      if (!all)
      {
        result.share.at<float>(row, bin) = count / static_cast<float>(edge * edge);
      }
    }
  }
  return result;
}

void AttenuationImage::readLine(int row, int column, std::vector<float>& values) const
{
  const auto count = static_cast<int>(values.size());
  switch (image_.depth())
  {
    case CV_8U:
      toFloats(image_.ptr<std::uint8_t>(row) + column, count, values.data());
      break;
    case CV_16U:
      toFloats(image_.ptr<std::uint16_t>(row) + column, count, values.data());
      break;
    default:
      std::copy_n(image_.ptr<float>(row) + column, count, values.data());
      break;
  }
}
}  // namespace xray_tracking
