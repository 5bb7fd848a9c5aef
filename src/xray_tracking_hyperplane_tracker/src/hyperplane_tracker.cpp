#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <sstream>
#include <stdexcept>

#include "contrast.h"
#include "point_sampler.h"
#include "predictor.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr int kMinRegionSize = 16;
/// Share of points outside the image that is still tracked; they take the mean difference of the others, which the
/// predictor does not see.
constexpr double kMaxOutside = 0.25;
/// A predictor hands over to the next one when its steps are this share of the next one's range.
constexpr double kHandOver = 0.2;

std::string description(const cv::Size& size, int type)
{
  return std::to_string(size.width) + " x " + std::to_string(size.height) + (type == CV_8UC1 ? " mono8" : " mono16");
}

/// Uniform random numbers that are the same with every standard library.
class Uniform
{
public:
  explicit Uniform(std::uint32_t seed) : engine_(seed) {}
  /// In [low, high).
  float operator()(double low, double high) { return static_cast<float>(low + (high - low) * engine_() / 4294967296.); }

private:
  std::mt19937 engine_;
};
/// Steps to where a predictor's answer A i is zero. The first is eq. (1)'s, m <- m - A i, which takes a unit slope for
/// granted; from then on the slope is what the steps have met (Broyden 1965, inverse form), because in an image that
/// has rotated, or in which parts move otherwise, it is another, and plain steps would circle around the answer.
class BroydenSteps
{
public:
  /// @param range what the predictor was trained on [px]; beyond it an answer has a direction but no size
  explicit BroydenSteps(float range) : range_(range) {}

  Eigen::Vector2f next(const Eigen::Vector2f& answer)
  {
    if (step_.squaredNorm() > 0.f)
    {
      const Eigen::Vector2f expected = inverse_slope_ * (answer - answer_);
      const float slope = step_.dot(expected) / step_.squaredNorm();
      if (slope > kMinSlope)
      {
        inverse_slope_ += (step_ - expected) * (step_.transpose() * inverse_slope_) / (slope * step_.squaredNorm());
      }
      else
      {
        // The noise has its own say between places so near; what it says about the slope is not worth keeping.
        inverse_slope_ = 0.5f * Eigen::Matrix2f::Identity();
      }
    }
    answer_ = answer;
    step_ = -inverse_slope_ * answer;
    const float length = step_.norm();
    if (length > range_)
    {
      step_ *= range_ / length;
    }
    return step_;
  }

private:
  static constexpr float kMinSlope = 0.3f;

  float range_;
  Eigen::Vector2f answer_ = Eigen::Vector2f::Zero();
  Eigen::Vector2f step_ = Eigen::Vector2f::Zero();
  Eigen::Matrix2f inverse_slope_ = Eigen::Matrix2f::Identity();
};
}  // namespace

void HyperplaneTrackerOptions::validate() const
{
  const auto require_positive = [](const char* key, double value)
  { requireOption(std::isfinite(value) && value > 0.0, key, value, "a number > 0"); };
  requireInRange("points", points, 50, 20000);
  requireOption(!ranges.empty(), "ranges", "empty", "one number or more");
  for (std::size_t i = 0; i < ranges.size(); ++i)
  {
    requireOption(std::isfinite(ranges[i]) && ranges[i] > 0.0 && (i == 0 || ranges[i] < ranges[i - 1]), "ranges",
                  ranges[i], "numbers > 0 that fall [px]");
  }
  requireInRange("training_motions", training_motions, 50, 100000);
  require_positive("ridge", ridge);
  requireOption(std::isfinite(background) && background >= 0.0, "background", background, "a number >= 0");
  requireOption(max_iterations >= 1, "max_iterations", max_iterations, "1 or more");
  require_positive("convergence", convergence);
  requireInRange("min_correlation", min_correlation, 0.0, 1.0);
  requireInRange("found_correlation", found_correlation, min_correlation, 1.0);
  require_positive("max_predicted_sd", max_predicted_sd);
}

/// What the training leaves, and the scratch memory of track().
struct HyperplaneTracker::Template
{
  cv::Size size;
  int type = 0;
  cv::Rect region;
  Points points;
  Box box;  ///< around the points
  Eigen::ArrayXf values;
  Eigen::MatrixXf nuisance;    ///< orthonormal; the last column is the template without the shading of those before
  float contrast = 0.f;        ///< norm of the template without shading
  float least_variance = 0.f;  ///< of a difference, from the image's quantisation alone
  std::vector<Points> predictors;

  Eigen::ArrayXf sampled;
  Eigen::ArrayXf outside;
  Eigen::VectorXf differences;
  Eigen::VectorXf coefficients;

  void place(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& rect, int count, Uniform& uniform)
  {
    size = image.size();
    type = image.type();
    region = rect;
    points.resize(count, 2);
    for (int i = 0; i < count; ++i)
    {
      points(i, 0) = static_cast<float>(rect.x) + uniform(0.0, rect.width - 1.0);
      points(i, 1) = static_cast<float>(rect.y) + uniform(0.0, rect.height - 1.0);
    }
    box = Box(points.colwise().minCoeff().transpose(), points.colwise().maxCoeff().transpose());
    values.resize(count);
    sampled.resize(count);
    outside.resize(count);
    differences.resize(count);
    samplePoints(image, intensity, points, box, Eigen::Vector2f::Zero(), values, outside);
  }

  Nuisance findNuisance()
  {
    const Eigen::MatrixXd shading = shadingPatterns(points, region);
    Eigen::MatrixXd patterns(points.rows(), shading.cols() + 1);
    patterns << shading, values.matrix().cast<double>();
    const Nuisance found(patterns);
    nuisance = found.basis();
    coefficients.resize(nuisance.cols());
    contrast = nuisance.rightCols<1>().dot(values.matrix());
    if (contrast < 0.f)
    {
      contrast = -contrast;
      nuisance.rightCols<1>() *= -1.f;
    }
    return found;
  }

  void learn(const cv::Mat& image, const IntensityModel& intensity, const HyperplaneTrackerOptions& options,
             const Nuisance& found, Uniform& uniform)
  {
    const Eigen::MatrixXf background = backgroundCovariance(points, found);
    Eigen::MatrixXf changes(points.rows(), options.training_motions);
    Points motions(options.training_motions, 2);
    for (const double range : options.ranges)
    {
      for (Eigen::Index j = 0; j < motions.rows(); ++j)
      {
        motions(j, 0) = uniform(-range, range);
        motions(j, 1) = uniform(-range, range);
        sampleAt(image, intensity, motions.row(j).transpose());
        changes.col(j) = differences;
      }
      // The overlay moves by as much whatever the predictor is trained on: next to large motions it hardly counts.
      const double share = std::pow(options.ranges.back() / range, 2);
      Eigen::MatrixXf prior = static_cast<float>(options.background * share) * background;
      prior.diagonal().array() += static_cast<float>(options.ridge);
      predictors.push_back(learnPredictor(changes, motions, prior, found));
    }
  }

  /// Samples at a displacement into `differences`. @return whether enough points are inside
  bool sampleAt(const cv::Mat& image, const IntensityModel& intensity, const Eigen::Vector2f& displacement)
  {
    const int count = samplePoints(image, intensity, points, box, displacement, sampled, outside);
    differences = (sampled - values).matrix();
    if (count == 0)
    {
      return true;
    }
    const float inside = static_cast<float>(points.rows() - count);
    const float mean = inside > 0.f ? (differences.array() * (1.f - outside)).sum() / inside : 0.f;
    differences.array() = differences.array() * (1.f - outside) + mean * outside;
    return count <= kMaxOutside * static_cast<double>(points.rows());
  }
};

HyperplaneTracker::HyperplaneTracker(const HyperplaneTrackerOptions& options, const IntensityModel& intensity)
  : options_(options), intensity_(intensity)
{
  options_.validate();
}

HyperplaneTracker::~HyperplaneTracker() = default;
HyperplaneTracker::HyperplaneTracker(HyperplaneTracker&&) noexcept = default;
HyperplaneTracker& HyperplaneTracker::operator=(HyperplaneTracker&&) noexcept = default;

void HyperplaneTracker::reset()
{
  template_.reset();
}

cv::Rect HyperplaneTracker::region() const
{
  return template_ ? template_->region : cv::Rect();
}

void HyperplaneTracker::train(const cv::Mat& image, const cv::Rect& region)
{
  checkImage(image);
  const cv::Rect inside = region & cv::Rect(cv::Point(), image.size());
  if (region.width < kMinRegionSize || region.height < kMinRegionSize || inside != region)
  {
    throw std::invalid_argument("region: is " + describe(region) + " in an image of " + std::to_string(image.cols) +
                                " x " + std::to_string(image.rows) + ", expected inside and " +
                                std::to_string(kMinRegionSize) + " px or more both ways");
  }

  Uniform uniform(options_.seed);
  auto learnt = std::make_unique<Template>();
  learnt->place(image, intensity_, region, options_.points, uniform);
  const Nuisance nuisance = learnt->findNuisance();
  const ContrastCheck contrast = checkContrast(image, intensity_, region, learnt->points, nuisance);
  if (!(contrast.predicted_sd <= options_.max_predicted_sd))
  {
    std::ostringstream message;
    message << "region: " << describe(region) << " has too little contrast: grey values change by " << contrast.gradient
            << " a pixel in their weakest direction, the noise is " << contrast.noise
            << ", which would move the estimate by " << contrast.predicted_sd << " px, expected at most "
            << options_.max_predicted_sd << " (max_predicted_sd)";
    throw std::invalid_argument(message.str());
  }
  learnt->least_variance = static_cast<float>(contrast.least_variance);
  learnt->learn(image, intensity_, options_, nuisance, uniform);
  template_ = std::move(learnt);
  last_good_.setZero();
  lost_ = false;
  result_ = TrackResult();
  result_.correlation = 1.;
}

const TrackResult& HyperplaneTracker::trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement)
{
  const Eigen::Vector2f last_good = last_good_;
  const bool lost = lost_;
  last_good_ = displacement.cast<float>();
  if (track(image).status != TrackResult::Status::TRACKED)
  {
    last_good_ = last_good;
    lost_ = lost;
  }
  return result_;
}

const TrackResult& HyperplaneTracker::track(const cv::Mat& image)
{
  if (!template_)
  {
    throw std::logic_error("HyperplaneTracker::track without a template");
  }
  Template& t = *template_;
  if (image.size() != t.size || image.type() != t.type)
  {
    checkImage(image);
    throw std::invalid_argument("image: is " + description(image.size(), image.type()) + ", expected " +
                                description(t.size, t.type) + " as the template's image");
  }

  result_ = TrackResult();
  Eigen::Vector2f displacement = last_good_;
  bool converged = false;
  float answer_length = 0.f;
  for (std::size_t level = 0; level < t.predictors.size(); ++level)
  {
    const Points& predictor = t.predictors[level];
    const float range = static_cast<float>(options_.ranges[level]);
    const bool last = level + 1 == t.predictors.size();
    const float tolerance = static_cast<float>(last ? options_.convergence : kHandOver * options_.ranges[level + 1]);
    converged = false;
    BroydenSteps steps(range);
    for (int k = 0; k < options_.max_iterations && !converged; ++k)
    {
      if (!t.sampleAt(image, intensity_, displacement))
      {
        result_.status = TrackResult::Status::OUT_OF_IMAGE;
        lost_ = true;
        return result_;
      }
      const Eigen::Vector2f answer(predictor.col(0).dot(t.differences), predictor.col(1).dot(t.differences));
      const Eigen::Vector2f step = steps.next(answer);
      displacement += step;
      ++result_.iterations;
      answer_length = answer.norm();
      converged = std::max(step.norm(), answer_length) < tolerance;
    }
  }

  // The last differences, taken a step of no consequence before the end, split into nuisance and the rest.
  t.coefficients.noalias() = t.nuisance.transpose() * t.differences;
  t.differences.noalias() -= t.nuisance * t.coefficients;
  const float residual = t.differences.squaredNorm();
  const float found_contrast = t.coefficients[t.coefficients.size() - 1] + t.contrast;
  // Quantisation counts as noise, lest an image without content correlate by its rounding errors.
  const float unexplained = residual + static_cast<float>(t.points.rows()) * t.least_variance;
  result_.correlation = found_contrast / std::sqrt(found_contrast * found_contrast + unexplained);
  const float variance = std::max(t.least_variance, residual / (t.points.rows() - t.nuisance.cols()));
  result_.displacement = displacement.cast<double>();
  result_.covariance = (variance * (t.predictors.back().transpose() * t.predictors.back())).cast<double>();

  // In much noise A i has no zero but gets as small as noise can make it, which is as good.
  if (!converged && answer_length > std::sqrt(result_.covariance.trace()))
  {
    result_.status = TrackResult::Status::DIVERGED;
  }
  else if (!(result_.correlation >= (lost_ ? options_.found_correlation : options_.min_correlation)))
  {
    result_.status = TrackResult::Status::LOW_CORRELATION;
  }
  lost_ = result_.status != TrackResult::Status::TRACKED;
  if (!lost_)
  {
    last_good_ = displacement;
  }
  return result_;
}
}  // namespace xray_tracking
