#include "random_room.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "starts.h"

namespace xray_tracking
{
namespace
{
constexpr double kOffset = 100.0;
constexpr double kAirCounts = 60000.0;

Eigen::Matrix3d turned(const Eigen::Vector3d& axis, double angle)
{
  return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
}
}  // namespace

double between(std::mt19937& random, double low, double high)
{
  return std::uniform_real_distribution<double>(low, high)(random);
}

double betweenLog(std::mt19937& random, double low, double high)
{
  return std::exp(between(random, std::log(low), std::log(high)));
}

bool withProbability(std::mt19937& random, double probability)
{
  return between(random, 0.0, 1.0) < probability;
}

std::vector<ProjectionGeometry> randomRoom(std::mt19937& random, const Eigen::Vector3d& long_axis, double field_mm,
                                           const RoomLimits& limits)
{
  const double kind = between(random, 0.0, 1.0);
  const int views = std::max(limits.least_views, kind < 0.04 ? 1 : kind < 0.8 ? 2 : 3);
  const Eigen::Vector3d axis = turned(randomDirection(random), between(random, 0.0, 0.25)) * long_axis;
  const double source_distance = betweenLog(random, 450.0, 2600.0);
  const double magnification = betweenLog(random, 1.05, 3.0);
  const int size = static_cast<int>(betweenLog(random, 256.0, limits.most_pixels));
  const double quarter = std::floor(between(random, 0.0, 4.0)) * 0.5 * EIGEN_PI;
  double angle = between(random, 0.0, 2.0 * EIGEN_PI);
  std::vector<ProjectionGeometry> detectors;
  for (int view = 0; view < views; ++view)
  {
    const Eigen::Vector3d across = turned(axis, angle) * axis.unitOrthogonal();
    const Eigen::Vector3d to_source = (across + between(random, -0.15, 0.15) * axis).normalized();
    const Eigen::Vector3d normal = turned(randomDirection(random), between(random, 0.0, 0.1)) * -to_source;
    DetectorDescription detector;
    detector.name = "detector_" + std::string(1, static_cast<char>('a' + view));
    detector.image_size = Eigen::Vector2i::Constant(size);
    detector.pixel_pitch = Eigen::Vector2d::Constant(magnification * field_mm / size);
    detector.source = source_distance * to_source;
    detector.x_direction =
        turned(normal, quarter + between(random, -0.1, 0.1)) * (axis - normal * normal.dot(axis)).normalized();
    detector.y_direction = normal.cross(detector.x_direction);
    const double off_centre = 0.08 * magnification * field_mm;
    const Eigen::Vector2d corner = -0.5 * (size - 1) * detector.pixel_pitch;
    detector.origin = -(magnification - 1.0) * source_distance * to_source +
                      (corner.x() + between(random, -off_centre, off_centre)) * detector.x_direction +
                      (corner.y() + between(random, -off_centre, off_centre)) * detector.y_direction;
    detectors.push_back(ProjectionGeometry::fromDescription(detector));
    angle += between(random, 20.0, 90.0) * kDegree;
  }
  return detectors;
}

RandomDetectors::RandomDetectors(std::mt19937& random, const std::vector<ProjectionGeometry>& geometries,
                                 const std::vector<cv::Rect>& regions)
  : regions_(regions), gains_(regions.size(), 0.0)
{
  const double pixel = geometries.front().pixelPitch().x() / geometries.front().magnification(Eigen::Vector3d::Zero());
  ImageFormationOptions options;
  options.polychromatic = withProbability(random, 0.75);
  mega_volt_ = withProbability(random, 0.12) ? between(random, 0.2, 0.35) : 0.0;
  options.scatter_fraction = between(random, 0.0, 0.7);
  options.scatter_sigma_px = std::clamp(between(random, 15.0, 60.0) / pixel, 8.0, 1000.0);
  options.blur_sigma_px =
      std::min(20.0, between(random, 0.1, 0.5) / pixel * (withProbability(random, 0.5) ? 1.0 : 0.3));
  options.air_quanta = std::min(1e9, betweenLog(random, 5e4, 3e6) * pixel * pixel);
  options.electronic_noise = betweenLog(random, 2.0, 60.0);
  IntensityModel raw;
  raw.offset = kOffset;
  raw.air_counts = kAirCounts;
  const bool blades = withProbability(random, 0.3);
  const bool round = !blades && withProbability(random, 0.3);
  const double pattern = withProbability(random, 0.4) ? betweenLog(random, 0.001, 0.01) : 0.0;
  for (std::size_t v = 0; v < geometries.size(); ++v)
  {
    formations_.emplace_back(options, raw, random());
    const cv::Size size(geometries[v].imageSize().x(), geometries[v].imageSize().y());
    const cv::Rect& region = regions[v];
    cv::Mat field(size, CV_32FC1, cv::Scalar(1.0));
    if (blades)
    {
      const auto margin = [&](int edge) { return static_cast<int>(std::lround(edge * between(random, -0.05, 0.5))); };
      const cv::Point first = region.tl() - cv::Point(margin(region.width), margin(region.height));
      const cv::Point last = region.br() + cv::Point(margin(region.width), margin(region.height));
      field.setTo(0.0);
      field(cv::Rect(first, last) & cv::Rect(cv::Point(), size)).setTo(1.0);
    }
    if (round)
    {
      field.setTo(0.0);
      cv::circle(field, (region.tl() + region.br()) / 2,
                 static_cast<int>(0.5 * std::hypot(region.width, region.height) * between(random, 0.85, 1.6)),
                 cv::Scalar(1.0), cv::FILLED);
    }
    cv::GaussianBlur(field, field, cv::Size(), std::max(0.5, between(random, 0.2, 1.0) / pixel));
    if (pattern > 0.0)
    {
      cv::Mat noise(size, CV_32FC1);
      cv::RNG(random()).fill(noise, cv::RNG::NORMAL, 1.0, pattern);
      field = field.mul(noise);
    }
    fields_.push_back(field);
  }
  plain_ = withProbability(random, 0.3);
  gamma_ = betweenLog(random, 0.5, 2.0);
  level_ = between(random, 0.5, 1.3);
  dark_ = withProbability(random, 0.4) ? betweenLog(random, 1e-3, 3e-2) : 0.0;
  const double bits = between(random, 0.0, 1.0);
  most_ = bits < 0.5 ? 255.0 : bits < 0.75 ? 4095.0 : 65535.0;
  if (plain_)
  {
    intensity_ = raw;
  }
  else if (withProbability(random, 0.5))
  {
    intensity_.air_counts = most_;
  }
}

cv::Mat RandomDetectors::expose(cv::Mat& soft, cv::Mat& bone, int detector, int exposure)
{
  if (mega_volt_ > 0.0)
  {
    // Compton scattering alone: by density, cortical bone 1.92 times water.
    soft = mega_volt_ * (soft + 1.92 * bone);
    bone.setTo(0.0);
  }
  cv::Mat counts, signal;
  formations_[detector].form(soft, bone, detector, exposure, counts);
  counts.convertTo(signal, CV_32F, 1.0 / (kAirCounts - kOffset), -kOffset / (kAirCounts - kOffset));
  signal = signal.mul(fields_[detector]);
  if (plain_)
  {
    signal.convertTo(counts, CV_16U, kAirCounts - kOffset, kOffset);
    return counts;
  }
  if (gains_[detector] == 0.0)
  {
    // As automatic exposure control does.
    std::vector<float> region;
    signal(regions_[detector]).clone().reshape(1, 1).copyTo(region);
    const auto bright = region.begin() + static_cast<std::ptrdiff_t>(0.95 * region.size());
    std::nth_element(region.begin(), bright, region.end());
    gains_[detector] = level_ / std::max(1e-4F, *bright);
  }
  signal = cv::min(cv::max(gains_[detector] * signal - dark_, 0.0), 1.0);
  cv::pow(signal, gamma_, signal);
  signal.convertTo(counts, CV_16U, most_);
  return counts;
}
}  // namespace xray_tracking
