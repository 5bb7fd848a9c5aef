#include "xray_tracking_hyperplane_tracker/region_overlay.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "point_sampler.h"

namespace xray_tracking
{
namespace
{
cv::Scalar residualColour(float residual)
{
  const double share = std::min(1.0, static_cast<double>(std::abs(residual)));
  return { 0.0, 255.0 * std::min(1.0, 2.0 * (1.0 - share)), 255.0 * std::min(1.0, 2.0 * share) };
}

/// Corners of the region's outermost pixels, moved.
std::array<cv::Point, 4> movedCorners(const cv::Rect& region, const TrackResult& track)
{
  const Eigen::Vector2d half(0.5 * (region.width - 1), 0.5 * (region.height - 1));
  const Eigen::Vector2d centre = Eigen::Vector2d(region.x, region.y) + half;
  const std::array<Eigen::Vector2d, 4> signs{ { { -1.0, -1.0 }, { 1.0, -1.0 }, { 1.0, 1.0 }, { -1.0, 1.0 } } };
  std::array<cv::Point, 4> corners;
  for (std::size_t i = 0; i < corners.size(); ++i)
  {
    const Eigen::Vector2d corner = centre + track.displacement + track.linear * half.cwiseProduct(signs[i]);
    corners[i] = cv::Point(cvRound(corner.x()), cvRound(corner.y()));
  }
  return corners;
}
}  // namespace

cv::Mat drawRegionOverlay(const cv::Mat& image, const RegionOverlay& overlay)
{
  checkImage(image);
  constexpr double kWindow = 3.0;  // standard deviations to either side
  const cv::Rect seen = overlay.reference & cv::Rect(cv::Point(), image.size());
  cv::Scalar mean, deviation;
  cv::meanStdDev(seen.empty() ? image : image(seen), mean, deviation);
  const double scale = 127.5 / std::max(1.0, kWindow * deviation[0]);
  cv::Mat grey, picture;
  image.convertTo(grey, CV_8U, scale, 127.5 - scale * mean[0]);
  cv::cvtColor(grey, picture, cv::COLOR_GRAY2BGR);
  if (overlay.reference.empty())
  {
    return picture;
  }
  cv::rectangle(picture, overlay.reference, overlay.found ? cv::Scalar(160, 160, 160) : overlay.colour);
  for (const ResidualPoint& point : overlay.points)
  {
    cv::circle(picture, point.place, 1, residualColour(point.residual), cv::FILLED);
  }
  if (overlay.found)
  {
    const std::array<cv::Point, 4> corners = movedCorners(overlay.reference, *overlay.found);
    for (std::size_t i = 0; i < corners.size(); ++i)
    {
      cv::line(picture, corners[i], corners[(i + 1) % corners.size()], overlay.colour, 2);
    }
  }
  return picture;
}
}  // namespace xray_tracking
