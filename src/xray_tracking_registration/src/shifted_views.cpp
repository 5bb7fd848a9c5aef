#include "shifted_views.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <tbb/parallel_for.h>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr double kReach = 25.0;          // of other places [mm]
constexpr double kStep = 2.0;            // between them [mm]
constexpr double kElsewhere = 5.0;       // wider than the peak of any structure that is compared [mm]
constexpr double kShiftStep = 1.0;       // of a shift that is looked for [mm]
constexpr double kShortest = 0.05;       // of correlation, that a shift by the reach has to be better by
constexpr int kLeastPlaces = 100;        // to tell how different places are
constexpr double kLeastVariance = 1e-4;  // of correlations, of which the smallest that were met have 1e-3
constexpr float kLeastShare = 0.5f;      // of a model's bins that have to be usable where it is slid to

/// Calls visit(shift) for a cubic grid of shifts.
template <typename Visit>
void forShifts(double reach, double step, Visit visit)
{
  const int steps = static_cast<int>(reach / step);
  for (int x = -steps; x <= steps; ++x)
  {
    for (int y = -steps; y <= steps; ++y)
    {
      for (int z = -steps; z <= steps; ++z)
      {
        visit(Eigen::Vector3d(step * Eigen::Vector3d(x, y, z)));
      }
    }
  }
}
}  // namespace

ShiftedViews::ShiftedViews(const Run& run, const std::vector<ViewLevel>& views, const std::vector<cv::Mat>& models,
                           const Eigen::Vector3d& room_centre, double reach)
  : views_(views.size())
{
  tbb::parallel_for(
      std::size_t{ 0 }, views.size(),
      [&](std::size_t v)
      { views_[v] = slide(run.request.views[v], run.attenuation[v], views[v], models[v], room_centre, reach); });
}

ShiftedViews::View ShiftedViews::slide(const RegistrationView& view, const AttenuationImage& attenuation,
                                       const ViewLevel& level, const cv::Mat& model, const Eigen::Vector3d& room_centre,
                                       double reach)
{
  const ProjectionGeometry& geometry = view.geometry;
  const auto bin = static_cast<int>(level.bin());
  const double edge = bin * geometry.pixelPitch().mean();
  const auto bins = static_cast<int>(std::ceil(reach * geometry.magnification(room_centre) / edge));
  const cv::Rect here(level.firstBin(), level.size());
  const cv::Rect around(here.x - bins, here.y - bins, here.width + 2 * bins, here.height + 2 * bins);
  const ViewLevel searched(geometry, attenuation, view.usable, cv::Rect(around.tl() * bin, around.size() * bin),
                           level.resolution(), {}, 0.0);
  View slid;
  slid.here = here.tl() - searched.firstBin();
  if (slid.here.x < 0 || slid.here.y < 0 || slid.here.x + here.width > searched.size().width ||
      slid.here.y + here.height > searched.size().height)
  {
    throw std::invalid_argument("view " + geometry.name() + ": nothing around the region");
  }
  cv::matchTemplate(searched.measuredImage(), model, slid.correlation, cv::TM_CCOEFF_NORMED);
  if (searched.valid().minCoeff() < 1.0f)
  {
    cv::Mat valid(searched.size(), CV_32FC1);
    std::copy_n(searched.valid().data(), searched.valid().size(), valid.ptr<float>());
    cv::Mat share;
    cv::boxFilter(valid, share, CV_32F, here.size(), cv::Point(0, 0), true, cv::BORDER_CONSTANT);
    slid.correlation.setTo(-2.0f, share(cv::Rect(cv::Point(), slid.correlation.size())) < kLeastShare);
  }
  for (int axis = 0; axis < 3; ++axis)
  {
    const Eigen::Vector3d half = 0.5 * Eigen::Vector3d::Unit(axis);
    slid.shifts.col(axis) = (geometry.project(room_centre + half) - geometry.project(room_centre - half)) / bin;
  }
  return slid;
}

std::optional<double> ShiftedViews::correlation(const Eigen::Vector3d& shift) const
{
  double sum = 0.0;
  for (const View& view : views_)
  {
    const Eigen::Vector2d bins = view.shifts * shift;
    const int column = view.here.x + cvRound(bins.x());
    const int row = view.here.y + cvRound(bins.y());
    if (column < 0 || row < 0 || column >= view.correlation.cols || row >= view.correlation.rows ||
        view.correlation.at<float>(row, column) < -1.5f)
    {
      return std::nullopt;
    }
    sum += view.correlation.at<float>(row, column);
  }
  return sum / static_cast<double>(views_.size());
}

double ShiftedViews::here() const
{
  // The peak may lie between bins.
  double sum = 0.0;
  for (const View& view : views_)
  {
    const cv::Rect near =
        cv::Rect(view.here.x - 1, view.here.y - 1, 3, 3) & cv::Rect(cv::Point(), view.correlation.size());
    double largest = 0.0;
    cv::minMaxLoc(view.correlation(near), nullptr, &largest);
    sum += largest;
  }
  return sum / static_cast<double>(views_.size());
}

Distinctness distinctnessOf(const Run& run, const FineLevel& fine, const Eigen::Vector3d& room_centre)
{
  std::vector<cv::Mat> models;
  for (std::size_t v = 0; v < fine.views.size(); ++v)
  {
    const Eigen::VectorXf& image = fine.at.models[v].image;
    models.emplace_back(fine.views[v].size(), CV_32FC1);
    std::copy_n(image.data(), image.size(), models.back().ptr<float>());
  }
  try
  {
    const ShiftedViews views(run, fine.views, models, room_centre, kReach);
    Distinctness result;
    result.here = views.here();
    double sum = 0.0;
    double squares = 0.0;
    int places = 0;
    forShifts(kReach, kStep,
              [&](const Eigen::Vector3d& shift)
              {
                const std::optional<double> there = shift.norm() < kElsewhere ? std::nullopt : views.correlation(shift);
                if (there)
                {
                  result.rival = std::max(result.rival, *there);
                  sum += *there;
                  squares += *there * *there;
                  ++places;
                }
              });
    const double mean = sum / std::max(places, 1);
    const double variance = squares / std::max(places, 1) - mean * mean;
    if (places >= kLeastPlaces)
    {
      result.z = (result.here - mean) / std::sqrt(std::max(variance, kLeastVariance));
      return result;
    }
  }
  catch (const std::invalid_argument&)
  {
    // Nothing around the region: nothing is known.
  }
  return {};
}

Eigen::Vector3d mostAlikeShift(const Run& run, const Bodies& bodies, const std::vector<ViewLevel>& views,
                               const PosePair& poses, double reach)
{
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  std::vector<cv::Mat> models(views.size());
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v) { views[v].modelImage(bodies, poses, poses.saturationOf(v), models[v]); });
  try
  {
    const ShiftedViews shifted(run, views, models, poses.target * bodies.centre, reach);
    double most = -1.0;
    forShifts(reach, kShiftStep,
              [&](const Eigen::Vector3d& shift)
              {
                const std::optional<double> there = shifted.correlation(shift);
                // Along what the views do not see, as depth in one, the shortest.
                const double worth = there.value_or(-1.0) - kShortest * shift.squaredNorm() / (reach * reach);
                if (there && worth > most)
                {
                  most = worth;
                  best = shift;
                }
              });
  }
  catch (const std::invalid_argument&)
  {
    // Nothing around a region: it stays where it is.
  }
  return best;
}
}  // namespace xray_tracking
