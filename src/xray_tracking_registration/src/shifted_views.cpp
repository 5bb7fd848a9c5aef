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
constexpr double kReach = kFine.around_mm;  // of other places
constexpr double kStep = 2.0;               // between them [mm]
constexpr double kElsewhere = 5.0;          // wider than the peak of any structure that is compared [mm]
constexpr double kShiftStep = 1.0;          // of a shift that is looked for [mm]
constexpr double kShortest = 0.05;          // of correlation, that a shift by the reach has to be better by
constexpr int kLeastPlaces = 100;           // to tell how different places are
constexpr double kLeastVariance = 1e-4;     // of correlations, of which the smallest that were met have 1e-3
constexpr float kLeastShare = 0.5f;         // of a model's bins that have to be usable where it is slid to

/// The views at a pose, and with the target shifted in space: every view's model is slid over its image, and the views'
/// correlations are put together where their shifts meet.
class ShiftedViews
{
public:
  /// @param views levels at the pose; they are slid as far as their images are laid out
  /// @param models of the views at the pose, high-passed, CV_32FC1
  /// @param room_centre of the target at the pose
  ShiftedViews(const std::vector<ViewLevel>& views, const std::vector<cv::Mat>& models,
               const Eigen::Vector3d& room_centre)
    : views_(views.size())
  {
    tbb::parallel_for(std::size_t{ 0 }, views.size(),
                      [&](std::size_t v) { views_[v] = slide(views[v], models[v], room_centre); });
  }

  /// Calls visit(shift, mean over the views of the correlation with the target shifted) for a cubic grid of shifts,
  /// where every view shows enough.
  template <typename Visit>
  void forShifts(double reach, double step, const Visit& visit) const
  {
    const int steps = static_cast<int>(reach / step);
    std::vector<double> line(2 * steps + 1);
    for (int x = -steps; x <= steps; ++x)
    {
      for (int y = -steps; y <= steps; ++y)
      {
        const Eigen::Vector3d first = step * Eigen::Vector3d(x, y, -steps);
        std::fill(line.begin(), line.end(), 0.0);
        for (const View& view : views_)
        {
          addLine(view, view.shifts * first, step * view.shifts.col(2), line);
        }
        for (int z = -steps; z <= steps; ++z)
        {
          if (const double sum = line[z + steps]; sum > kUnknown / 2.0)
          {
            visit(Eigen::Vector3d(step * Eigen::Vector3d(x, y, z)), sum / static_cast<double>(views_.size()));
          }
        }
      }
    }
  }

  /// The mean correlation without a shift, as far as bins allow.
  double here() const
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

private:
  static constexpr double kUnknown = -1e6;

  struct View
  {
    cv::Mat correlation;                 ///< CV_32FC1 wherever the model is slid to; kUnknown where it is not known
    cv::Point here;                      ///< where the model is at the pose
    Eigen::Matrix<double, 2, 3> shifts;  ///< by a shift of the target in the room [bins / mm]
  };

  static View slide(const ViewLevel& level, const cv::Mat& model, const Eigen::Vector3d& room_centre)
  {
    const Surroundings searched = level.surroundings();
    View slid;
    slid.here = searched.region;
    cv::matchTemplate(searched.image, model, slid.correlation, cv::TM_CCOEFF_NORMED);
    if (!searched.counts.empty())
    {
      cv::Mat share;
      cv::boxFilter(searched.counts, share, CV_32F, model.size(), cv::Point(0, 0), true,
                    cv::BORDER_CONSTANT | cv::BORDER_ISOLATED);
      slid.correlation.setTo(kUnknown, share(cv::Rect(cv::Point(), slid.correlation.size())) < kLeastShare);
    }
    const ProjectionGeometry& geometry = level.geometry();
    for (int axis = 0; axis < 3; ++axis)
    {
      const Eigen::Vector3d half = 0.5 * Eigen::Vector3d::Unit(axis);
      slid.shifts.col(axis) =
          (geometry.project(room_centre + half) - geometry.project(room_centre - half)) / level.bin();
    }
    return slid;
  }

  /// Adds a view's correlations along a line of shifts.
  static void addLine(const View& view, Eigen::Vector2d bins, const Eigen::Vector2d& by, std::vector<double>& line)
  {
    for (double& sum : line)
    {
      const int column = view.here.x + cvRound(bins.x());
      const int row = view.here.y + cvRound(bins.y());
      const bool inside = column >= 0 && row >= 0 && column < view.correlation.cols && row < view.correlation.rows;
      sum += inside ? static_cast<double>(view.correlation.at<float>(row, column)) : kUnknown;
      bins += by;
    }
  }

  std::vector<View> views_;
};

std::vector<cv::Mat> asMats(const FineLevel& fine)
{
  std::vector<cv::Mat> models;
  for (std::size_t v = 0; v < fine.views.size(); ++v)
  {
    const Eigen::VectorXf& image = fine.at.models[v].image;
    models.emplace_back(fine.views[v].size(), CV_32FC1);
    std::copy_n(image.data(), image.size(), models.back().ptr<float>());
  }
  return models;
}
}  // namespace

Distinctness distinctnessOf(const FineLevel& fine, const Eigen::Vector3d& room_centre)
{
  const ShiftedViews views(fine.views, asMats(fine), room_centre);
  Distinctness result;
  result.here = views.here();
  double sum = 0.0;
  double squares = 0.0;
  int places = 0;
  views.forShifts(kReach, kStep,
                  [&](const Eigen::Vector3d& shift, double there)
                  {
                    if (shift.squaredNorm() >= kElsewhere * kElsewhere)
                    {
                      result.rival = std::max(result.rival, there);
                      sum += there;
                      squares += there * there;
                      ++places;
                    }
                  });
  const double mean = sum / std::max(places, 1);
  const double variance = squares / std::max(places, 1) - mean * mean;
  if (places < kLeastPlaces)
  {
    return {};
  }
  result.z = (result.here - mean) / std::sqrt(std::max(variance, kLeastVariance));
  return result;
}

Eigen::Vector3d mostAlikeShift(const Bodies& bodies, const std::vector<ViewLevel>& views, const PosePair& poses,
                               double reach)
{
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  std::vector<cv::Mat> models(views.size());
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v) { views[v].modelImage(bodies, poses, poses.saturationOf(v), models[v]); });
  const ShiftedViews shifted(views, models, poses.target * bodies.centre);
  double most = -1.0;
  shifted.forShifts(reach, kShiftStep,
                    [&](const Eigen::Vector3d& shift, double there)
                    {
                      // Along what the views do not see, as depth in one, the shortest.
                      const double worth = there - kShortest * shift.squaredNorm() / (reach * reach);
                      if (worth > most)
                      {
                        most = worth;
                        best = shift;
                      }
                    });
  return best;
}
}  // namespace xray_tracking
