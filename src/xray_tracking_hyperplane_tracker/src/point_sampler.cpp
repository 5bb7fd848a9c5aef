#include "point_sampler.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
/// Weights along one axis: of pixels around a place, those outside the image are its border's.
class Taps
{
public:
  Taps(Sampling sampling, float place, int last)
  {
    const int before = std::min(static_cast<int>(place), last - 1);
    const float part = place - static_cast<float>(before);
    count_ = sampling == Sampling::SPLINE ? 4 : 2;
    if (sampling == Sampling::SPLINE)
    {
      splineWeights(part, weights_);
    }
    else
    {
      weights_[0] = 1.f - part;
      weights_[1] = part;
    }
    for (int i = 0; i < count_; ++i)
    {
      pixels_[i] = std::clamp(before + i - (count_ / 2 - 1), 0, last);
    }
  }
  /// @param value of a pixel along the axis
  template <typename Value>
  float sum(const Value& value) const
  {
    float sum = 0.f;
    for (int i = 0; i < count_; ++i)
    {
      sum += weights_[i] * value(pixels_[i]);
    }
    return sum;
  }

private:
  int count_;
  float weights_[4];
  int pixels_[4];
};

template <typename Pixel>
int sampleClamped(const cv::Mat& image, Sampling sampling, const Points& points, const PixelMap& m,
                  Eigen::Ref<Eigen::ArrayXf> values, Eigen::Ref<Eigen::ArrayXf> outside)
{
  const int last_column = image.cols - 1;
  const int last_row = image.rows - 1;
  int count = 0;
  for (Eigen::Index i = 0; i < points.rows(); ++i)
  {
    const float x = m.xx * points(i, 0) + (m.xy * points(i, 1) + m.x0);
    const float y = m.yx * points(i, 0) + (m.yy * points(i, 1) + m.y0);
    const float inside_x = std::min(std::max(x, 0.f), static_cast<float>(last_column));
    const float inside_y = std::min(std::max(y, 0.f), static_cast<float>(last_row));
    const bool is_outside = inside_x != x || inside_y != y;
    outside[i] = is_outside ? 1.f : 0.f;
    count += is_outside;
    const Taps columns(sampling, inside_x, last_column);
    values[i] = Taps(sampling, inside_y, last_row)
                    .sum(
                        [&](int row)
                        {
                          const Pixel* pixels = image.ptr<Pixel>(row);
                          return columns.sum([pixels](int column) { return static_cast<float>(pixels[column]); });
                        });
  }
  return count;
}

/// Whether every point in the box is mapped inside the image, so far that all pixels around it are.
bool isInside(const cv::Mat& image, Sampling sampling, const Box& box, const PixelMap& m)
{
  // Half a thousandth of a pixel for what rounding makes of other points.
  const float margin = (sampling == Sampling::SPLINE ? 1.f : 0.f) + 5e-4f;
  for (const auto corner : { Box::BottomLeft, Box::BottomRight, Box::TopLeft, Box::TopRight })
  {
    const Eigen::Vector2f p = box.corner(corner);
    const float x = m.xx * p.x() + m.xy * p.y() + m.x0;
    const float y = m.yx * p.x() + m.yy * p.y() + m.y0;
    if (!(x >= margin && y >= margin && x < static_cast<float>(image.cols - 1) - margin &&
          y < static_cast<float>(image.rows - 1) - margin))
    {
      return false;
    }
  }
  return true;
}
}  // namespace

void checkImage(const cv::Mat& image)
{
  if (image.dims != 2 || image.cols < 2 || image.rows < 2 || (image.type() != CV_8UC1 && image.type() != CV_16UC1))
  {
    throw std::invalid_argument("image: is " + std::to_string(image.cols) + " x " + std::to_string(image.rows) +
                                " of OpenCV type " + std::to_string(image.type()) +
                                ", expected one channel of 8 or 16 bit, 2 x 2 pixels or more");
  }
}

int samplePoints(const cv::Mat& image, Sampling sampling, const IntensityModel& intensity, const Points& points,
                 const Box& box, const PixelMap& map, Eigen::Ref<Eigen::ArrayXf> values,
                 Eigen::Ref<Eigen::ArrayXf> outside)
{
  int count = 0;
  if (image.type() == CV_8UC1)
  {
    count = sampleClamped<std::uint8_t>(image, sampling, points, map, values, outside);
  }
  else if (isInside(image, sampling, box, map))
  {
    const auto sample = sampling == Sampling::SPLINE ? sampleSpline : sampleBilinear;
    sample(image.ptr<std::uint16_t>(), image.step1(), points.data(), points.data() + points.rows(), points.rows(), map,
           values.data());
  }
  else
  {
    count = sampleClamped<std::uint16_t>(image, sampling, points, map, values, outside);
  }
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    attenuate(values.data(), values.size(), static_cast<float>(intensity.offset));
  }
  return count;
}

cv::Mat splineFiltered(const cv::Mat& image)
{
  float weights[4];
  splineWeights(0.f, weights);  // the last one is zero
  const cv::Mat kernel(3, 1, CV_32F, weights);
  cv::Mat filtered;
  cv::sepFilter2D(image, filtered, CV_32F, kernel, kernel, cv::Point(-1, -1), 0.0, cv::BORDER_REPLICATE);
  return filtered;
}
}  // namespace xray_tracking
