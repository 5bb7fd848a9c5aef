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
int sampleClamped(const cv::Mat& image, const Points& points, const PixelMap& m, Eigen::Ref<Eigen::ArrayXf> values,
                  Eigen::Ref<Eigen::ArrayXf> outside)
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
    const int left = std::min(static_cast<int>(inside_x), last_column - 1);
    const int top = std::min(static_cast<int>(inside_y), last_row - 1);
    const float u = inside_x - static_cast<float>(left), v = inside_y - static_cast<float>(top);
    const auto row = [&](int y)
    {
      const std::uint16_t* p = image.ptr<std::uint16_t>(y) + left;
      return p[0] + u * static_cast<float>(p[1] - p[0]);
    };
    values[i] = (1.f - v) * row(top) + v * row(top + 1);
  }
  return count;
}

/// Whether every point in the box is mapped inside the image, so far that all pixels around it are.
bool isInside(const cv::Mat& image, const Box& box, const PixelMap& m)
{
  constexpr float kMargin = 5e-4f;  // for what rounding makes of other points
  for (const auto corner : { Box::BottomLeft, Box::BottomRight, Box::TopLeft, Box::TopRight })
  {
    const Eigen::Vector2f p = box.corner(corner);
    const float x = m.xx * p.x() + m.xy * p.y() + m.x0;
    const float y = m.yx * p.x() + m.yy * p.y() + m.y0;
    if (!(x >= kMargin && y >= kMargin && x < static_cast<float>(image.cols - 1) - kMargin &&
          y < static_cast<float>(image.rows - 1) - kMargin))
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

int samplePoints(const cv::Mat& image, const IntensityModel& intensity, const Points& points, const Box& box,
                 const PixelMap& map, Eigen::Ref<Eigen::ArrayXf> values, Eigen::Ref<Eigen::ArrayXf> outside)
{
  int count = 0;
  if (isInside(image, box, map))
  {
    sampleBilinear(image.ptr<std::uint16_t>(), image.step1(), points.data(), points.data() + points.rows(),
                   points.rows(), map, values.data());
  }
  else
  {
    count = sampleClamped(image, points, map, values, outside);
  }
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    attenuate(values.data(), values.size(), static_cast<float>(intensity.offset));
  }
  return count;
}

cv::Mat attenuationImage(const cv::Mat& image, const IntensityModel& intensity)
{
  cv::Mat values;
  image.convertTo(values, CV_32F);
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    values = cv::max(values - intensity.offset, 1.0);
    cv::log(values, values);
    values = -values;
  }
  return values;
}
}  // namespace xray_tracking
