#include "point_sampler.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace xray_tracking
{
namespace
{
template <typename Pixel>
inline float bilinear(const Pixel* p, std::size_t row_length, float u, float v)
{
  const float upper = p[0] + u * static_cast<float>(p[1] - p[0]);
  const float lower = p[row_length] + u * static_cast<float>(p[row_length + 1] - p[row_length]);
  return upper + v * (lower - upper);
}

/// For points of which none is outside the image or on its last row or column.
template <typename Pixel>
void sampleInside(const cv::Mat& image, const Points& points, const Eigen::Vector2f& displacement,
                  Eigen::Ref<Eigen::ArrayXf> values)
{
  const Pixel* pixels = image.ptr<Pixel>();
  const std::size_t row_length = image.step1();
  for (Eigen::Index i = 0; i < points.rows(); ++i)
  {
    const float x = points(i, 0) + displacement.x();
    const float y = points(i, 1) + displacement.y();
    const int column = static_cast<int>(x);
    const int row = static_cast<int>(y);
    values[i] = bilinear(pixels + row * row_length + column, row_length, x - column, y - row);
  }
}

template <typename Pixel>
int sampleClamped(const cv::Mat& image, const Points& points, const Eigen::Vector2f& displacement,
                  Eigen::Ref<Eigen::ArrayXf> values, Eigen::Ref<Eigen::ArrayXf> outside)
{
  const int last_column = image.cols - 1;
  const int last_row = image.rows - 1;
  int count = 0;
  for (Eigen::Index i = 0; i < points.rows(); ++i)
  {
    const float x = points(i, 0) + displacement.x();
    const float y = points(i, 1) + displacement.y();
    const float inside_x = std::min(std::max(x, 0.f), static_cast<float>(last_column));
    const float inside_y = std::min(std::max(y, 0.f), static_cast<float>(last_row));
    const bool is_outside = inside_x != x || inside_y != y;
    outside[i] = is_outside ? 1.f : 0.f;
    count += is_outside;
    const int column = std::min(static_cast<int>(inside_x), last_column - 1);
    const int row = std::min(static_cast<int>(inside_y), last_row - 1);
    values[i] = bilinear(image.ptr<Pixel>(row) + column, image.step1(), inside_x - column, inside_y - row);
  }
  return count;
}

template <typename Pixel>
int sample(const cv::Mat& image, const Points& points, const Box& box, const Eigen::Vector2f& displacement,
           Eigen::Ref<Eigen::ArrayXf> values, Eigen::Ref<Eigen::ArrayXf> outside)
{
  const Eigen::Vector2f last(image.cols - 1, image.rows - 1);
  if (((box.min() + displacement).array() >= 0.f).all() && ((box.max() + displacement).array() < last.array()).all())
  {
    sampleInside<Pixel>(image, points, displacement, values);
    return 0;
  }
  return sampleClamped<Pixel>(image, points, displacement, values, outside);
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
                 const Eigen::Vector2f& displacement, Eigen::Ref<Eigen::ArrayXf> values,
                 Eigen::Ref<Eigen::ArrayXf> outside)
{
  const int count = image.type() == CV_8UC1 ? sample<std::uint8_t>(image, points, box, displacement, values, outside)
                                            : sample<std::uint16_t>(image, points, box, displacement, values, outside);
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    values = -(values - static_cast<float>(intensity.offset)).max(1.f).log();
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
