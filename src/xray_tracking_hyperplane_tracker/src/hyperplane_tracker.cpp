#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>

#include "coarse_image.h"
#include "image_check.h"
#include "point_sampler.h"
#include "region_template.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
/// A degraded region is good again when its quality is this much above the threshold.
constexpr double kQualityHysteresis = 0.05;
/// The coarsest predictor that does not reach farther is the first one for what is near [px]: a neighbouring vertebra,
/// which looks alike, is farther away.
constexpr double kNear = 20.0;

/// Of the memory that a training may take [bytes].
constexpr double kMostMemory = 1e9;

/// Mean logarithm of what is left of the region's variance, where all of it is left in what did not count: the negative
/// log likelihood, but for constants, of noise where it counted and of anything elsewhere.
double misfit(const SearchResult& found)
{
  constexpr double kLeastVariance = 1e-6;
  return found.share * std::log(std::max(kLeastVariance, 1.0 - found.correlation * found.correlation));
}
}  // namespace

void HyperplaneTrackerOptions::validate() const
{
  const auto require_positive = [](const char* key, double value)
  { requireOption(std::isfinite(value) && value > 0.0, key, value, "a number > 0"); };
  requireInRange("reduction", reduction, 1, 64);
  requireInRange("points", points, 50, 20000);
  requireOption(!ranges.empty(), "ranges", "empty", "one number or more");
  for (std::size_t i = 0; i < ranges.size(); ++i)
  {
    requireOption(ranges[i] > 0.0 && ranges[i] <= 1000.0 && (i == 0 || ranges[i] < ranges[i - 1]), "ranges", ranges[i],
                  "numbers > 0 that fall, up to 1000 [px]");
  }
  requireInRange("bin", bin, 1, 16);
  requireInRange("training_motions", training_motions, 50, 100000);
  // The differences of all motions, and four matrices of the points' covariances.
  const double memory = sizeof(float) * static_cast<double>(points) * (training_motions + 4.0 * points);
  requireOption(memory <= kMostMemory, "points (with training_motions " + std::to_string(training_motions) + ")",
                points, "so few that a training takes at most 1e9 bytes, 4 points (training_motions + 4 points)");
  requireOption(rotation_range > 0.0 && rotation_range <= 45.0, "rotation_range", rotation_range,
                "a number > 0, up to 45 [deg]");
  requireOption(scale_range > 0.0 && scale_range <= 0.5, "scale_range", scale_range, "a number > 0, up to 0.5");
  requireInRange("background", background, 0.0, 1000.0);
  requireInRange("max_iterations", max_iterations, 1, 1000);
  require_positive("convergence", convergence);
  requireInRange("min_correlation", min_correlation, 0.0, 1.0);
  requireInRange("found_correlation", found_correlation, min_correlation, 1.0);
  requireInRange("min_quality", min_quality, 0.0, 1.0);
  requireInRange("good_quality", good_quality, min_quality, 1.0);
  require_positive("max_predicted_sd", max_predicted_sd);
}

/// What a tracker sees of images: means over squares of pixels, or the images themselves.
class HyperplaneTracker::View
{
public:
  View(const cv::Mat& image, const cv::Rect& region, int reduction)
    : size_(image.size()), type_(image.type()), region_(region)
  {
    constexpr int kLeastSize = 32;
    edge_ = std::clamp(reduction, 1, std::max(1, std::min(region.width, region.height) / kLeastSize));
    if (edge_ > 1)
    {
      means_.emplace(image, edge_);
    }
  }

  /// No allocation; what is returned lasts until the next image.
  const cv::Mat& operator()(const cv::Mat& image)
  {
    requireTemplatesKind(image, size_, type_);
    if (!means_)
    {
      return image;
    }
    means_->update(image, cv::Rect(cv::Point(), size_));
    return means_->pixels();
  }
  IntensityModel intensity(const IntensityModel& of_image) const
  {
    return means_ ? means_->intensity(of_image) : of_image;
  }
  const cv::Rect& region() const { return region_; }
  cv::Rect reducedRegion() const
  {
    return { region_.x / edge_, region_.y / edge_, region_.width / edge_, region_.height / edge_ };
  }
  int edge() const { return edge_; }
  /// With the lengths in this view's pixels, which are smaller than asked for where the region is.
  HyperplaneTrackerOptions scaled(HyperplaneTrackerOptions options) const
  {
    const double scale = static_cast<double>(options.reduction) / edge_;
    for (double& range : options.ranges)
    {
      range *= scale;
    }
    options.convergence *= scale;
    options.max_predicted_sd *= scale;
    return options;
  }
  /// From the middle of the reduced region to the region's, in the image [px].
  Eigen::Vector2d offset() const
  {
    const auto along = [this](int first, int size)
    { return first + 0.5 * (size - 1) - (edge_ * (first / edge_ + 0.5 * (size / edge_)) - 0.5); };
    return { along(region_.x, region_.width), along(region_.y, region_.height) };
  }

private:
  cv::Size size_;
  int type_;
  cv::Rect region_;
  int edge_;
  std::optional<CoarseImage> means_;
};

struct HyperplaneTracker::State
{
  View view;
  std::vector<double> ranges;  ///< of the predictors, in the view
  double near;                 ///< kNear, in the view
  RegionTemplate region_template;
  Warp warp;  ///< where the region was last found, in the view
};

HyperplaneTracker::HyperplaneTracker(const HyperplaneTrackerOptions& options, const IntensityModel& intensity)
  : options_(options), intensity_(intensity)
{
  options_.validate();
}

HyperplaneTracker::~HyperplaneTracker() = default;
HyperplaneTracker::HyperplaneTracker(HyperplaneTracker&&) noexcept = default;
HyperplaneTracker& HyperplaneTracker::operator=(HyperplaneTracker&&) noexcept = default;

void HyperplaneTracker::setThresholds(const HyperplaneTrackerOptions& options)
{
  options.validate();
  options_.min_correlation = options.min_correlation;
  options_.found_correlation = options.found_correlation;
  options_.min_quality = options.min_quality;
  options_.good_quality = options.good_quality;
}

void HyperplaneTracker::reset()
{
  state_.reset();
}

cv::Rect HyperplaneTracker::region() const
{
  return state_ ? state_->view.region() : cv::Rect();
}

void HyperplaneTracker::train(const cv::Mat& image, const cv::Rect& region)
{
  checkImage(image);
  requireRegionInside(region, image.size());
  View view(image, region, options_.reduction);
  const HyperplaneTrackerOptions scaled = view.scaled(options_);
  RegionTemplate learnt(view(image), view.reducedRegion(), scaled, view.intensity(intensity_));
  const double near = kNear * options_.reduction / view.edge();
  state_ = std::make_unique<State>(State{ std::move(view), scaled.ranges, near, std::move(learnt), Warp() });
  lost_ = false;
  result_ = TrackResult();
  result_.correlation = 1.0;
  result_.quality = 1.0;
}

bool HyperplaneTracker::retrain(const cv::Mat& image)
{
  if (!track(image).found())
  {
    return false;
  }
  state_->region_template.learnAgain(state_->view(image), state_->warp);
  return true;
}

const TrackResult& HyperplaneTracker::track(const cv::Mat& image)
{
  search(image, state_ ? state_->warp : Warp(), false);
  lost_ = !result_.found();
  return result_;
}

const TrackResult& HyperplaneTracker::trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement)
{
  const double edge = state_ ? state_->view.edge() : 1.0;
  search(image, { displacement / edge, Eigen::Matrix2d::Identity() }, true);
  lost_ = lost_ && !result_.found();
  return result_;
}

void HyperplaneTracker::search(const cv::Mat& image, const Warp& start, bool only_near)
{
  if (!state_)
  {
    throw std::logic_error("HyperplaneTracker::track without a template");
  }
  RegionTemplate& t = state_->region_template;
  const cv::Mat& seen = state_->view(image);
  std::size_t first = 0;
  while (only_near && first + 1 < t.levels() && state_->ranges[first] > state_->near)
  {
    ++first;
  }

  // What covers a part of the region confuses the coarse predictors more than the fine ones, and may send them to a
  // neighbour that looks alike. So what is degraded, not found or far away is looked for from near, too.
  const bool degraded = !lost_ && result_.status == TrackResult::Status::DEGRADED;
  // Past the last predictor there are only the last steps, if there are any.
  const std::size_t last = options_.whole_region ? t.levels() : t.levels() - 1;
  std::optional<SearchResult> best;
  int iterations = 0;
  for (std::size_t level = first; level <= last; ++level)
  {
    const SearchResult found = t.search(seen, start, level);
    iterations += found.iterations;
    const TrackResult::Status status = judged(found, degraded);
    const bool success = status == TrackResult::Status::TRACKED || status == TrackResult::Status::DEGRADED;
    const bool better = success && (!best || misfit(found) < misfit(*best));
    if (better || level == first)
    {
      adopt(found, status);
    }
    if (better)
    {
      best = found;
    }
    const bool is_last = level + 1 >= t.levels();
    if (status == TrackResult::Status::TRACKED &&
        (is_last || (found.warp.translation - start.translation).norm() < state_->ranges[level + 1]))
    {
      break;
    }
  }
  if (best)
  {
    state_->warp = best->warp;
    t.believe(*best);
  }
  result_.iterations = iterations;
}

TrackResult::Status HyperplaneTracker::judged(const SearchResult& found, bool degraded) const
{
  if (found.status != TrackResult::Status::TRACKED)
  {
    return found.status;
  }
  if (!(found.correlation >= (lost_ ? options_.found_correlation : options_.min_correlation)))
  {
    return TrackResult::Status::LOW_CORRELATION;
  }
  const double quality = found.correlation * found.share;
  if (!(quality >= options_.min_quality))
  {
    return TrackResult::Status::LOW_CORRELATION;
  }
  return quality >= options_.good_quality + (degraded ? kQualityHysteresis : 0.0) ? TrackResult::Status::TRACKED
                                                                                  : TrackResult::Status::DEGRADED;
}

void HyperplaneTracker::adopt(const SearchResult& found, TrackResult::Status status)
{
  const RegionTemplate& t = state_->region_template;
  result_ = TrackResult();
  result_.status = status;
  // From the view's pixels and the middle of its region to the image's.
  const double edge = state_->view.edge();
  const Eigen::RowVector2d arm = state_->view.offset().transpose();
  Eigen::Matrix<double, 6, 6> to_image = Eigen::Matrix<double, 6, 6>::Identity();
  to_image.topLeftCorner<2, 2>() *= edge;
  to_image.block<1, 2>(0, 2) = arm;
  to_image.block<1, 2>(1, 4) = arm;
  result_.displacement = edge * found.warp.translation + found.warp.linear * arm.transpose() - arm.transpose();
  result_.linear = found.warp.linear;
  const auto derivative = (to_image * warpDerivative(found.warp, t.parameters(), t.radius())).eval();
  const Eigen::Matrix<double, 6, 6> covariance = derivative * found.covariance * derivative.transpose();
  result_.covariance = 0.5 * (covariance + covariance.transpose());  // rounding is not symmetric
  result_.correlation = found.correlation;
  result_.quality = std::max(0.0, found.correlation) * found.share;
}
}  // namespace xray_tracking
