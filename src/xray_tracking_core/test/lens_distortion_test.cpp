#include "xray_tracking_core/image/lens_distortion.h"

#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
/// 300 x 200 pixels of unlike pitch, the foot off the centre.
ProjectionGeometry detector()
{
  DetectorDescription description;
  description.name = "detector";
  description.image_size = { 300, 200 };
  description.pixel_pitch = { 1.0, 1.25 };
  description.source = { 0.0, 0.0, 0.0 };
  description.x_direction = { 1.0, 0.0, 0.0 };
  description.y_direction = { 0.0, 1.0, 0.0 };
  description.origin = { -160.0, -110.0, 800.0 };
  return ProjectionGeometry::fromDescription(description);
}

/// Smooth, of 1000 to 61000, with waves of 60 px. Linear interpolation is off by up to 15000 (pi / 30)^2 / 8 = 21 an
/// axis, and OpenCV finds places to 1/32 px, which makes 15000 (pi / 30) / 64 = 25 an axis.
double pattern(double u, double v)
{
  return 31000.0 + 15000.0 * std::sin(u * M_PI / 30.0) + 15000.0 * std::cos(v * M_PI / 30.0 + 0.4);
}
constexpr double kInterpolation = 100.0;

using Distort = std::function<Eigen::Vector2d(const Eigen::Vector2d& normalised)>;

/// The formulas of the camera_info message's definition (image_pipeline/CameraInfo), Brown's: written out here.
Distort brown(const std::vector<double>& c)
{
  return [c](const Eigen::Vector2d& point)
  {
    const double x = point.x();
    const double y = point.y();
    const double r2 = x * x + y * y;
    const double k3 = c.size() > 4 ? c[4] : 0.0;
    double radial = 1.0 + c[0] * r2 + c[1] * r2 * r2 + k3 * r2 * r2 * r2;
    if (c.size() == 8)
    {
      radial /= 1.0 + c[5] * r2 + c[6] * r2 * r2 + c[7] * r2 * r2 * r2;
    }
    return Eigen::Vector2d(x * radial + 2.0 * c[2] * x * y + c[3] * (r2 + 2.0 * x * x),
                           y * radial + c[2] * (r2 + 2.0 * y * y) + 2.0 * c[3] * x * y);
  };
}

/// What a distorted detector sees of the pattern: at each of its pixels the one of the point that comes to lie there,
/// found by repeated substitution.
cv::Mat distortedPattern(const Distort& distort)
{
  const ProjectionGeometry geometry = detector();
  cv::Mat image(geometry.imageSize().y(), geometry.imageSize().x(), CV_16UC1);
  for (int v = 0; v < image.rows; ++v)
  {
    for (int u = 0; u < image.cols; ++u)
    {
      const Eigen::Vector2d seen = (Eigen::Vector2d(u, v) - geometry.foot()).cwiseQuotient(geometry.focalLength());
      Eigen::Vector2d point = seen;
      for (int k = 0; k < 200; ++k)
      {
        point += seen - distort(point);
      }
      const Eigen::Vector2d pixel = geometry.foot() + point.cwiseProduct(geometry.focalLength());
      image.at<std::uint16_t>(v, u) = static_cast<std::uint16_t>(std::lround(pattern(pixel.x(), pixel.y())));
    }
  }
  return image;
}

void expectStraight(const std::string& model, const std::vector<double>& coefficients, double least_moved)
{
  const ProjectionGeometry geometry = detector();
  const Distort distort = brown(coefficients);
  const cv::Mat image = distortedPattern(distort);
  const cv::Mat straight = LensDistortion(model, coefficients, geometry).undo(image, IntensityModel::Kind::COUNTS);
  ASSERT_EQ(CV_16UC1, straight.type());
  ASSERT_EQ(image.size(), straight.size());
  double most = 0.0;
  double most_distorted = 0.0;
  int inside = 0;
  for (int v = 0; v < image.rows; ++v)
  {
    for (int u = 0; u < image.cols; ++u)
    {
      const Eigen::Vector2d at =
          geometry.foot() + distort((Eigen::Vector2d(u, v) - geometry.foot()).cwiseQuotient(geometry.focalLength()))
                                .cwiseProduct(geometry.focalLength());
      if (at.x() >= 0.0 && at.y() >= 0.0 && at.x() <= image.cols - 1 && at.y() <= image.rows - 1)
      {
        most = std::max(most, std::abs(straight.at<std::uint16_t>(v, u) - pattern(u, v)));
        most_distorted = std::max(most_distorted, std::abs(image.at<std::uint16_t>(v, u) - pattern(u, v)));
        ++inside;
      }
      else if (at.x() < -1.0 || at.y() < -1.0 || at.x() > image.cols || at.y() > image.rows)
      {
        EXPECT_EQ(0, straight.at<std::uint16_t>(v, u)) << u << ", " << v;
      }
    }
  }
  EXPECT_GT(inside, image.rows * image.cols * 3 / 4);
  EXPECT_LT(most, kInterpolation) << model;
  EXPECT_GT(most_distorted, least_moved * 15000.0 * M_PI / 30.0) << "nothing was distorted";
}

TEST(LensDistortion, ImagesAreWhatTheProjectionDescribes)
{
  expectStraight("plumb_bob", { -0.4, 0.2, 0.002, -0.003 }, 1.0);      // barrel
  expectStraight("plumb_bob", { 0.5, 0.1, -0.001, 0.002, 0.3 }, 1.0);  // pincushion
  expectStraight("rational_polynomial", { 0.6, 0.1, 0.001, 0.001, 0.05, 1.2, 0.2, 0.01 }, 1.0);
}

TEST(LensDistortion, NothingOfItIsTheImageItself)
{
  const cv::Mat image = distortedPattern(brown({ 0.0, 0.0, 0.0, 0.0 }));
  const LensDistortion none("plumb_bob", { 0.0, 0.0, 0.0, 0.0, 0.0 }, detector());
  EXPECT_TRUE(none.none());
  EXPECT_EQ(image.data, none.undo(image, IntensityModel::Kind::COUNTS).data);
}

/// Of line integrals the darkest are the largest.
TEST(LensDistortion, WhatNoPixelSawIsDark)
{
  const LensDistortion pincushion("plumb_bob", { 0.8, 0.0, 0.0, 0.0 }, detector());
  const cv::Mat image(200, 300, CV_16UC1, cv::Scalar(700));
  EXPECT_EQ(0, pincushion.undo(image, IntensityModel::Kind::COUNTS).at<std::uint16_t>(0, 0));
  EXPECT_EQ(65535, pincushion.undo(image, IntensityModel::Kind::ATTENUATION).at<std::uint16_t>(0, 0));
}

TEST(LensDistortion, NamesWhatIsOfNoUse)
{
  const auto refused = [](const std::string& model, const std::vector<double>& coefficients, const std::string& words)
  {
    try
    {
      const LensDistortion taken(model, coefficients, detector());
      ADD_FAILURE() << "taken, expected a refusal that says " << words;
    }
    catch (const std::invalid_argument& error)
    {
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  refused("equidistant", { 0.1, 0.0, 0.0, 0.0 }, "'equidistant': expected plumb_bob or rational_polynomial");
  refused("", { 0.1, 0.0, 0.0, 0.0 }, "distortion.model is ''");
  refused("plumb_bob", {}, "has 0 numbers: expected 4 or 5");
  refused("plumb_bob", { 0.1 }, "has 1 numbers: expected 4 or 5");
  refused("plumb_bob", std::vector<double>(8, 0.0), "has 8 numbers: expected 4 or 5");
  refused("rational_polynomial", { 0.1, 0.0, 0.0, 0.0, 0.0 }, "has 5 numbers: expected 8");
  refused("plumb_bob", { 0.1, nan, 0.0, 0.0 }, "coefficients[1] is nan");
  // The image's corner is at r = 0.243: k1 = -6 turns the radius back from 0.236 on; 3e4 is as of pixels.
  refused("plumb_bob", { -6.0, 0.0, 0.0, 0.0 }, "is folded over its neighbours");
  refused("plumb_bob", { 3e4, 0.0, 0.0, 0.0 }, "are the coefficients for pixels?");
  refused("plumb_bob", { 0.0, 0.0, 0.0, 1e300 }, "is moved by");
}
}  // namespace
}  // namespace xray_tracking
