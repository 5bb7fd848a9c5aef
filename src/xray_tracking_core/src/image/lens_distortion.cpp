#include "xray_tracking_core/image/lens_distortion.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <sstream>
#include <stdexcept>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr int kGrid = 64;  // points along either edge at which a distortion is looked at
constexpr double kMost = 0.25;

/// @param x, y where pixels are found, CV_32FC1
void requireUse(const cv::Mat& x, const cv::Mat& y)
{
  const double most = kMost * std::max(x.cols, x.rows);
  const auto refuse = [](int column, int row, const std::string& what)
  {
    std::ostringstream text;
    text << "distortion: pixel (" << column << ", " << row << ") " << what;
    throw std::invalid_argument(text.str());
  };
  const int step = std::max(1, std::min(x.cols, x.rows) / kGrid);
  for (int row = 0; row + step < x.rows; row += step)
  {
    for (int column = 0; column + step < x.cols; column += step)
    {
      const cv::Point2d here(x.at<float>(row, column), y.at<float>(row, column));
      const cv::Point2d right(x.at<float>(row, column + step), y.at<float>(row, column + step));
      const cv::Point2d below(x.at<float>(row + step, column), y.at<float>(row + step, column));
      const double away = std::hypot(here.x - column, here.y - row);
      if (!(away <= most))
      {
        refuse(column, row,
               "is moved by " + std::to_string(away) + " px: expected at most " + std::to_string(most) +
                   ", a quarter of the image (are the coefficients for pixels? They are for pixels over fx and fy)");
      }
      if (!((right - here).cross(below - here) > 0.0))
      {
        refuse(column, row, "is folded over its neighbours: expected coefficients that keep their order everywhere");
      }
    }
  }
}
}  // namespace

LensDistortion::LensDistortion(const std::string& model, const std::vector<double>& coefficients,
                               const ProjectionGeometry& detector)
{
  const std::size_t count = coefficients.size();
  if (model != "plumb_bob" && model != "rational_polynomial")
  {
    throw std::invalid_argument("distortion.model is '" + model + "': expected plumb_bob or rational_polynomial");
  }
  const bool plumb_bob = model == "plumb_bob";
  if (plumb_bob ? count != 4 && count != 5 : count != 8)
  {
    throw std::invalid_argument("distortion.coefficients has " + std::to_string(count) + " numbers: expected " +
                                (plumb_bob ? "4 or 5, k1, k2, p1, p2, k3, of plumb_bob"
                                           : "8, k1, k2, p1, p2, k3, k4, k5, k6, of rational_polynomial"));
  }
  const auto infinite =
      std::find_if(coefficients.begin(), coefficients.end(), [](double value) { return !std::isfinite(value); });
  if (infinite != coefficients.end())
  {
    throw std::invalid_argument("distortion.coefficients[" + std::to_string(infinite - coefficients.begin()) + "] is " +
                                std::to_string(*infinite) + ": expected a finite number");
  }
  if (std::all_of(coefficients.begin(), coefficients.end(), [](double value) { return value == 0.0; }))
  {
    return;
  }
  const cv::Matx33d camera(detector.focalLength().x(), 0.0, detector.foot().x(),  //
                           0.0, detector.focalLength().y(), detector.foot().y(),  //
                           0.0, 0.0, 1.0);
  const cv::Size size(detector.imageSize().x(), detector.imageSize().y());
  cv::initUndistortRectifyMap(camera, coefficients, cv::noArray(), camera, size, CV_32FC1, map_x_, map_y_);
  requireUse(map_x_, map_y_);
}

cv::Mat LensDistortion::undo(const cv::Mat& image, IntensityModel::Kind kind) const
{
  if (none())
  {
    return image;
  }
  const double brightest =
      image.depth() == CV_8U ? std::numeric_limits<std::uint8_t>::max() : std::numeric_limits<std::uint16_t>::max();
  const double dark = kind == IntensityModel::Kind::COUNTS ? 0.0 : brightest;
  cv::Mat straight;
  cv::remap(image, straight, map_x_, map_y_, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar::all(dark));
  return straight;
}
}  // namespace xray_tracking
