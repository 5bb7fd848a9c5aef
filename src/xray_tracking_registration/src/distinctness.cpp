#include "distinctness.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <tbb/parallel_for.h>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr double kReach = 25.0;     // [mm]
constexpr double kStep = 2.0;       // of places in space [mm]
constexpr double kElsewhere = 5.0;  // wider than the peak of any structure that is compared [mm]
constexpr float kLeastShare = 0.5;  // of a model's bins that have to be usable where it is slid to

/// One view's correlation wherever its model is slid to.
struct Slid
{
  cv::Mat correlation;                 ///< CV_32FC1; below -1 where it is not known
  cv::Point here;                      ///< where the model is at the pose
  Eigen::Matrix<double, 2, 3> shifts;  ///< by a shift of the target in the room [bins / mm]
};

Slid slide(const RegistrationView& view, const cv::Mat& attenuation, const Bodies& bodies, const ViewLevel& level,
           double saturation, const PosePair& poses)
{
  const Eigen::Vector3d centre = poses.target * bodies.centre;
  const ProjectionGeometry& geometry = view.geometry;
  const auto bin = static_cast<int>(level.bin());
  const double edge = bin * geometry.pixelPitch().mean();
  const auto reach = static_cast<int>(std::ceil(kReach * geometry.magnification(centre) / edge));
  const cv::Rect here(level.firstBin(), level.size());
  const cv::Rect around(here.x - reach, here.y - reach, here.width + 2 * reach, here.height + 2 * reach);
  const ViewLevel searched(geometry, attenuation, view.usable, cv::Rect(around.tl() * bin, around.size() * bin),
                           level.resolution(), {}, 0.0);
  cv::Mat model;
  level.modelImage(bodies, poses, saturation, model);
  Slid slid;
  slid.here = here.tl() - searched.firstBin();
  if (searched.size().width < here.width || searched.size().height < here.height || slid.here.x < 0 || slid.here.y < 0)
  {
    throw std::invalid_argument("view " + geometry.name() + ": nothing around the region");
  }
  cv::matchTemplate(searched.measuredImage(), model, slid.correlation, cv::TM_CCOEFF_NORMED);
  cv::Mat valid(searched.size(), CV_32FC1);
  std::copy_n(searched.valid().data(), searched.valid().size(), valid.ptr<float>());
  if (cv::countNonZero(valid) < static_cast<int>(valid.total()))
  {
    cv::Mat share;
    cv::boxFilter(valid, share, CV_32F, here.size(), cv::Point(0, 0), true, cv::BORDER_ISOLATED);
    slid.correlation.setTo(-2.0f, share(cv::Rect(cv::Point(), slid.correlation.size())) < kLeastShare);
  }
  for (int axis = 0; axis < 3; ++axis)
  {
    const Eigen::Vector3d half = 0.5 * Eigen::Vector3d::Unit(axis);
    slid.shifts.col(axis) = (geometry.project(centre + half) - geometry.project(centre - half)) / bin;
  }
  return slid;
}

/// The largest value within a bin of the place, as the peak may lie between bins.
double peakAt(const Slid& slid)
{
  const cv::Rect near =
      cv::Rect(slid.here.x - 1, slid.here.y - 1, 3, 3) & cv::Rect(cv::Point(), slid.correlation.size());
  double largest = 0.0;
  cv::minMaxLoc(slid.correlation(near), nullptr, &largest);
  return largest;
}
}  // namespace

Distinctness distinctnessOf(const Run& run, const Bodies& bodies, const std::vector<ViewLevel>& fine,
                            const PosePair& poses)
{
  std::vector<Slid> slid(fine.size());
  try
  {
    tbb::parallel_for(
        std::size_t{ 0 }, fine.size(),
        [&](std::size_t v)
        { slid[v] = slide(run.request.views[v], run.attenuation[v], bodies, fine[v], poses.saturationOf(v), poses); });
  }
  catch (const std::invalid_argument&)
  {
    return {};
  }
  const auto views = static_cast<double>(slid.size());
  Distinctness result;
  for (const Slid& view : slid)
  {
    result.here += peakAt(view) / views;
  }
  double sum = 0.0;
  double squares = 0.0;
  int places = 0;
  for (double x = -kReach + 1.0; x < kReach; x += kStep)
  {
    for (double y = -kReach + 1.0; y < kReach; y += kStep)
    {
      for (double z = -kReach + 1.0; z < kReach; z += kStep)
      {
        const Eigen::Vector3d shift(x, y, z);
        if (shift.norm() < kElsewhere)
        {
          continue;
        }
        double correlation = 0.0;
        bool known = true;
        for (const Slid& view : slid)
        {
          const Eigen::Vector2d bins = view.shifts * shift;
          const int column = view.here.x + static_cast<int>(std::lround(bins.x()));
          const int row = view.here.y + static_cast<int>(std::lround(bins.y()));
          known = known && column >= 0 && row >= 0 && column < view.correlation.cols && row < view.correlation.rows &&
                  view.correlation.at<float>(row, column) > -1.5f;
          if (!known)
          {
            break;
          }
          correlation += view.correlation.at<float>(row, column) / views;
        }
        if (known)
        {
          result.rival = std::max(result.rival, correlation);
          sum += correlation;
          squares += correlation * correlation;
          ++places;
        }
      }
    }
  }
  if (places < 2)
  {
    return {};
  }
  const double mean = sum / places;
  const double variance = squares / places - mean * mean;
  result.z = variance > 0.0 ? (result.here - mean) / std::sqrt(variance) : 0.0;
  return result;
}
}  // namespace xray_tracking
