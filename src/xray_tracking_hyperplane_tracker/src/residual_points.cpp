#include "xray_tracking_hyperplane_tracker/residual_points.h"

#include <algorithm>
#include <cmath>

#include <Eigen/QR>
#include <opencv2/imgproc.hpp>

#include "image_check.h"
#include "point_sampler.h"
#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr double kPoints = 400.0;
constexpr int kNuisances = 7;  ///< shading, and last the template
}  // namespace

std::vector<ResidualPoint> residualPoints(const cv::Mat& reference, const cv::Rect& region, const cv::Mat& image,
                                          const TrackResult& track, const IntensityModel& intensity)
{
  requireRegionInside(region, reference.size());
  requireTemplatesKind(image, reference.size(), reference.type());
  const cv::Point2d middle(0.5 * (region.width - 1), 0.5 * (region.height - 1));
  const Eigen::Matrix2d& l = track.linear;
  const cv::Point2d centre(region.x + middle.x + track.displacement.x(), region.y + middle.y + track.displacement.y());
  const auto image_from_patch = [&](double x, double y)
  {
    const double u = x - middle.x, v = y - middle.y;
    return cv::Point2d(centre.x + l(0, 0) * u + l(0, 1) * v, centre.y + l(1, 0) * u + l(1, 1) * v);
  };
  // Attenuation only where it is looked at: the patch, and what is interpolated with.
  const std::vector<cv::Point2f> corners{ image_from_patch(-1.0, -1.0), image_from_patch(region.width, -1.0),
                                          image_from_patch(-1.0, region.height),
                                          image_from_patch(region.width, region.height) };
  const cv::Rect part = cv::boundingRect(corners) & cv::Rect(cv::Point(), image.size());
  if (part.empty())
  {
    return {};
  }
  const cv::Point2d origin = image_from_patch(0.0, 0.0) - cv::Point2d(part.tl());
  const cv::Matx23d map(l(0, 0), l(0, 1), origin.x, l(1, 0), l(1, 1), origin.y);
  cv::Mat found;
  cv::warpAffine(attenuationImage(image(part), intensity), found, map, region.size(),
                 cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);

  const double cell = std::max(1.0, std::sqrt(region.area() / kPoints));
  const cv::Size grid(cvFloor(region.width / cell), cvFloor(region.height / cell));
  cv::Mat then, now;
  cv::resize(attenuationImage(reference(region), intensity), then, grid, 0.0, 0.0, cv::INTER_AREA);
  cv::resize(found, now, grid, 0.0, 0.0, cv::INTER_AREA);

  std::vector<ResidualPoint> points;
  Eigen::MatrixXd nuisance(grid.area(), kNuisances);
  Eigen::VectorXd values(grid.area());
  const cv::Rect2d inside(0.0, 0.0, image.cols - 1.0, image.rows - 1.0);
  for (int j = 0; j < grid.height; ++j)
  {
    for (int i = 0; i < grid.width; ++i)
    {
      const cv::Point2d place =
          image_from_patch((i + 0.5) * region.width / grid.width - 0.5, (j + 0.5) * region.height / grid.height - 0.5);
      if (inside.contains(place))
      {
        const auto row = static_cast<Eigen::Index>(points.size());
        const double x = 2.0 * i / grid.width - 1.0, y = 2.0 * j / grid.height - 1.0;
        nuisance.row(row) << 1.0, x, y, x * x, x * y, y * y, then.at<float>(j, i);
        values[row] = now.at<float>(j, i);
        points.push_back({ place, 0.0F });
      }
    }
  }
  const auto count = static_cast<Eigen::Index>(points.size());
  if (count < 4 * kNuisances)
  {
    return {};
  }
  const auto columns = nuisance.topRows(count);
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> fit(columns);
  const Eigen::VectorXd coefficients = fit.solve(values.head(count));
  const Eigen::VectorXd residuals = values.head(count) - columns * coefficients;
  const Eigen::VectorXd texture = columns.rightCols<1>();
  // What shading explains of the template is not contrast.
  const auto shading = columns.leftCols<kNuisances - 1>();
  const Eigen::VectorXd plain = texture - shading * Eigen::ColPivHouseholderQR<Eigen::MatrixXd>(shading).solve(texture);
  const double contrast = std::abs(coefficients[kNuisances - 1]) * plain.norm() / std::sqrt(static_cast<double>(count));
  for (Eigen::Index i = 0; i < count; ++i)
  {
    points[static_cast<std::size_t>(i)].residual = static_cast<float>(residuals[i] / std::max(contrast, 1e-9));
  }
  return points;
}
}  // namespace xray_tracking
