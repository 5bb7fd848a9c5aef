#include "binned_image.h"

#include <algorithm>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
BinnedImage binned(const cv::Mat& image, const cv::Point& corner, int bin)
{
  BinnedImage result{ {}, corner, bin };
  const cv::Size size(image.cols / bin, image.rows / bin);
  cv::resize(image(cv::Rect(cv::Point(), size * bin)), result.values, size, 0.0, 0.0, cv::INTER_AREA);
  return result;
}

cv::Mat sharpPart(const cv::Mat& image, const cv::Rect& part, const IntensityModel& intensity)
{
  constexpr int kBox = 17;
  cv::Mat slow;
  cv::Mat values = attenuationImage(image(part), intensity);
  cv::GaussianBlur(values, values, cv::Size(), kSmoothing);
  cv::blur(values, slow, { kBox, kBox }, { -1, -1 }, cv::BORDER_REPLICATE);
  values -= slow;
  return values;
}

void sampleMoved(const BinnedImage& reference, const Eigen::Vector2d& centre, const PlanarRigidMotion& motion,
                 const BinnedImage& image, cv::Mat& moved)
{
  moved.create(reference.values.size(), CV_32FC1);
  const Eigen::Matrix2d rotation = Eigen::Rotation2Dd(motion[2]).toRotationMatrix();
  const Eigen::Vector2d place = centre + motion.head<2>() + rotation * (reference.place(0.0, 0.0) - centre);
  const Eigen::Vector2f first = ((place - image.place(0.0, 0.0)) / image.bin).cast<float>();
  const Eigen::Matrix2f step = rotation.cast<float>();
  const float last_x = static_cast<float>(image.values.cols - 1);
  const float last_y = static_cast<float>(image.values.rows - 1);
  for (int row = 0; row < moved.rows; ++row)
  {
    float* values = moved.ptr<float>(row);
    const Eigen::Vector2f start = first + static_cast<float>(row) * step.col(1);
    for (int column = 0; column < moved.cols; ++column)
    {
      const float x = std::clamp(start.x() + static_cast<float>(column) * step(0, 0), 0.f, last_x);
      const float y = std::clamp(start.y() + static_cast<float>(column) * step(1, 0), 0.f, last_y);
      const int left = std::min(static_cast<int>(x), image.values.cols - 2);
      const int top = std::min(static_cast<int>(y), image.values.rows - 2);
      const float u = x - static_cast<float>(left);
      const float v = y - static_cast<float>(top);
      const float* p = image.values.ptr<float>(top) + left;
      const float* q = image.values.ptr<float>(top + 1) + left;
      const float upper = p[0] + u * (p[1] - p[0]);
      const float lower = q[0] + u * (q[1] - q[0]);
      values[column] = upper + v * (lower - upper);
    }
  }
}
}  // namespace xray_tracking
