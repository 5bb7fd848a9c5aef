#include "contrast.h"
#include "xray_tracking_core/image/attenuation.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
/// Smoothing before the gradient [px]: most noise is gone, bone edges are not.
constexpr double kScale = 2.0;

}  // namespace

ContrastCheck checkContrast(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& region,
                            const Points& points, const Nuisance& nuisance, double samples)
{
  // With a margin, lest the smoothing's border bend what is straight.
  const int margin = static_cast<int>(4.0 * kScale);
  const cv::Rect seen =
      cv::Rect(region.x - margin, region.y - margin, region.width + 2 * margin, region.height + 2 * margin) &
      cv::Rect(cv::Point(), image.size());
  cv::Mat values = attenuationImage(image(seen), intensity);
  ContrastCheck check;
  double quantum = greyStep(image(seen));
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    quantum /= std::max(1.0, cv::mean(image(region))[0] - intensity.offset);
  }
  check.noise = NoiseSpectrum(values, unsaturated(image, seen, intensity), quantum * quantum / 12.0);

  cv::GaussianBlur(values, values, cv::Size(), kScale);
  Points gradients(points.rows(), 2);
  for (Eigen::Index i = 0; i < points.rows(); ++i)
  {
    const int x = std::clamp(static_cast<int>(points(i, 0)) - seen.x, 1, seen.width - 2);
    const int y = std::clamp(static_cast<int>(points(i, 1)) - seen.y, 1, seen.height - 2);
    gradients(i, 0) = 0.5f * (values.at<float>(y, x + 1) - values.at<float>(y, x - 1));
    gradients(i, 1) = 0.5f * (values.at<float>(y + 1, x) - values.at<float>(y - 1, x));
  }
  nuisance.removeFrom(gradients);
  const double noise_gradient =
      check.noise.variance([](double u, double v)
                           { return 2.0 * M_PI * u * std::exp(-2.0 * std::pow(M_PI * kScale, 2) * (u * u + v * v)); });
  const Eigen::Matrix2d tensor = (gradients.transpose() * gradients).cast<double>();
  const double weakest = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(tensor).eigenvalues()[0] -
                         static_cast<double>(points.rows()) * noise_gradient;
  check.gradient = std::sqrt(std::max(0.0, weakest) / static_cast<double>(points.rows()));
  // Both images have the noise, hence the factor 2.
  check.predicted_sd = weakest > 0.0 ? std::sqrt(2.0 * check.noise.slowPower() / samples) / check.gradient
                                     : std::numeric_limits<double>::infinity();
  return check;
}

std::string describe(const cv::Rect& region)
{
  return std::to_string(region.width) + " x " + std::to_string(region.height) + " at (" + std::to_string(region.x) +
         ", " + std::to_string(region.y) + ")";
}
}  // namespace xray_tracking
