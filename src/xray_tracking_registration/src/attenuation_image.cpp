#include "xray_tracking_registration/attenuation_image.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace xray_tracking
{
namespace
{
template <typename Value, typename Map>
void mapValues(const cv::Mat& image, const Map& map, cv::Mat& mapped)
{
  mapped.create(image.size(), CV_32FC1);
  tbb::parallel_for(tbb::blocked_range<int>(0, image.rows, 64),
                    [&](const tbb::blocked_range<int>& rows)
                    {
                      for (int row = rows.begin(); row != rows.end(); ++row)
                      {
                        const Value* from = image.ptr<Value>(row);
                        std::transform(from, from + image.cols, mapped.ptr<float>(row), map);
                      }
                    });
}
}  // namespace

void attenuationImage(const cv::Mat& image, const IntensityModel& intensity, cv::Mat& attenuation)
{
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_16UC1 && image.type() != CV_32FC1))
  {
    throw std::invalid_argument("image: expected one channel of 8 or 16 bit without sign or of float, not empty");
  }
  if (!cv::checkRange(image))
  {
    throw std::invalid_argument("image: has values that are not finite");
  }
  if (intensity.kind == IntensityModel::Kind::ATTENUATION)
  {
    image.convertTo(attenuation, CV_32F);
    return;
  }
  double largest = std::numeric_limits<std::uint8_t>::max();
  if (image.depth() != CV_8U || !intensity.air_counts)
  {
    cv::minMaxLoc(image, nullptr, &largest);
  }
  const double air = intensity.air_counts.value_or(largest);
  if (!(air > intensity.offset))
  {
    throw std::invalid_argument("intensity: air counts are " + std::to_string(air) +
                                ": expected more than the offset " + std::to_string(intensity.offset));
  }
  const auto attenuationOf = [&](double counts)
  { return static_cast<float>(std::log((air - intensity.offset) / std::max(counts - intensity.offset, 1.0))); };
  if (image.depth() == CV_32F)
  {
    mapValues<float>(image, attenuationOf, attenuation);
    return;
  }
  // As many logarithms as there are values, not pixels.
  std::vector<float> table(static_cast<std::size_t>(largest) + 1);
  for (std::size_t counts = 0; counts < table.size(); ++counts)
  {
    table[counts] = attenuationOf(static_cast<double>(counts));
  }
  const auto lookUp = [&table](std::size_t counts) { return table[counts]; };
  image.depth() == CV_8U ? mapValues<std::uint8_t>(image, lookUp, attenuation)
                         : mapValues<std::uint16_t>(image, lookUp, attenuation);
}
}  // namespace xray_tracking
