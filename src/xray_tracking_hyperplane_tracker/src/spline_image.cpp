#include "spline_image.h"

#include <algorithm>
#include <cstdint>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
/// @tparam kStep step's value, for loops that the compiler makes vectors of; 0: any
template <int kStep, typename Pixel>
void takeApart(const Pixel* pixels, int count, int any_step, float* values, int plane)
{
  const int step = kStep > 0 ? kStep : any_step;
  for (int p = 0; p < step; ++p, values += plane)
  {
    for (int i = 0; i < count; ++i)
    {
      values[i] = pixels[i * step + p];
    }
  }
}
}  // namespace

SplineImage::SplineImage(int step, int most)
  : step_(step), values_(most, (most + step - 1) / step * step, CV_32FC1), plane_(values_.cols / step)
{
  for (int i = 0; i < values_.cols; ++i)
  {
    column_.push_back(i % step * plane_ + i / step);
  }
}

template <typename Pixel>
void SplineImage::fill(const cv::Mat& image)
{
  // Columns of the part inside the image, in whole steps from the part's first one; the others one by one.
  const int count = (part_.width + step_ - 1) / step_;
  const int first = std::clamp((step_ - 1 - part_.x) / step_, 0, count);
  const int last = std::clamp((image.cols - part_.x) / step_, first, count);
  for (int y = 0; y < part_.height; ++y)
  {
    const Pixel* pixels = image.ptr<Pixel>(std::clamp(part_.y + y, 0, image.rows - 1));
    float* values = values_.ptr<float>(y);
    const auto one_by_one = [&](int from, int to)
    {
      for (int i = from; i < to; ++i)
      {
        for (int p = 0; p < step_; ++p)
        {
          values[p * plane_ + i] = pixels[std::clamp(part_.x + i * step_ + p, 0, image.cols - 1)];
        }
      }
    };
    one_by_one(0, first);
    const Pixel* inside = pixels + part_.x + static_cast<std::ptrdiff_t>(first) * step_;
    const auto take = step_ == 1 ? takeApart<1, Pixel> : step_ == 2 ? takeApart<2, Pixel> : takeApart<0, Pixel>;
    take(inside, last - first, step_, values + first, plane_);
    one_by_one(last, count);
  }
}

bool SplineImage::update(const cv::Mat& image, const cv::Rect& part)
{
  if (part.width > values_.cols || part.height > values_.rows)
  {
    return false;
  }
  part_ = part;
  if (image.depth() == CV_8U)
  {
    fill<std::uint8_t>(image);
  }
  else
  {
    fill<std::uint16_t>(image);
  }
  return true;
}

SplineSource SplineImage::source() const
{
  return { values_.ptr<float>(), values_.cols, column_.data(), step_ };
}

PixelMap SplineImage::toPart(PixelMap map) const
{
  map.x0 -= static_cast<float>(part_.x);
  map.y0 -= static_cast<float>(part_.y);
  return map;
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
