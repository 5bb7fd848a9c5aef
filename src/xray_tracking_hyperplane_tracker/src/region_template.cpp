#include "region_template.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>

#include "broyden_steps.h"
#include "contrast.h"

namespace xray_tracking
{
namespace
{
/// Share of points outside the image that is still tracked; they take the mean difference of the others, which the
/// predictor does not see.
constexpr double kMaxOutside = 0.25;
/// A predictor hands over to the next one when its steps are this share of the next one's range.
constexpr double kHandOver = 0.2;
/// Motions whose grey-value changes are those of an overlay with weight one [px]. The last steps, which need not find
/// the region from afar, reckon with one that moves by more.
constexpr double kBackgroundRange = 1.5;
constexpr double kOverlayMotion = 5.5;
/// The last steps: how many, the longest that is believed, and that which needs none after it [px].
constexpr int kMaxFits = 24;
constexpr float kFitRange = 3.f;
constexpr float kFitConvergence = 0.02f;
/// Mean disagreement (RegionFit) of images without an overlay that moves on its own, at most, and of those with one.
constexpr double kAgreeing = 2.0;
constexpr double kDisagreeing = 8.0;
/// Of an overlay that moves on its own, before the first image: 1 to 3.
const double kFirstEvidence = -std::log(3.0);
/// Largest evidence for either: beyond 20 to 1 what comes next could not change it soon enough.
const double kMostEvidence = std::log(20.0);
/// Bins that a region has at least in both directions.
constexpr int kMinBins = 16;
/// Differences in units of the template's standard deviation: up to the first they count in full, from the second on
/// not at all.
constexpr float kFullDifference = 1.5f;
constexpr float kNoDifference = 4.5f;
constexpr int kMiddlePasses = 60;
}  // namespace

RegionTemplate::RegionTemplate(const cv::Mat& image, const cv::Rect& region, const HyperplaneTrackerOptions& options,
                               const IntensityModel& intensity)
  : options_(options),
    intensity_(intensity),
    size_(image.size()),
    region_(region),
    centre_(region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)),
    radius_(std::sqrt((region.width * region.width + region.height * region.height) / 12.0)),
    parameters_(static_cast<int>(options.model)),
    coarse_(image, std::max(1, std::min(options.bin, std::min(region.width, region.height) / kMinBins))),
    evidence_(kFirstEvidence)
{
  Uniform uniform(options.seed);
  placePoints(uniform);
  coarse_.update(image, cv::Rect(cv::Point(), size_));
  sample(image, Warp());
  const Nuisance nuisance = nuisanceOf(sampled_);
  const double samples = options.whole_region ? std::min<double>(region.area(), kMaxFitPixels) : options.points;
  const ContrastCheck contrast = checkContrast(image, intensity, region, points_, nuisance, samples);
  if (!(contrast.predicted_sd <= options.max_predicted_sd))
  {
    std::ostringstream message;
    message << "region: " << describe(region) << " has too little contrast: grey values change by " << contrast.gradient
            << " a pixel in their weakest direction, the noise is " << std::sqrt(contrast.noise.variance())
            << ", which would move the estimate by " << contrast.predicted_sd << " px, expected at most "
            << options.max_predicted_sd << " (max_predicted_sd)";
    throw std::invalid_argument(message.str());
  }
  model_.noise = contrast.noise;
  bin_noise_ = contrast.noise.varianceOfMeans(coarse_.bin());
  for (const double range : options.ranges)
  {
    levels_.emplace_back().range = static_cast<float>(range);
  }
  texture_ = textureOf(sampled_, nuisance);
  learnLevels(image, Warp(), uniform, levels_.size());
  if (options.whole_region)
  {
    DifferenceModel model = model_;
    model.background *= std::pow(kOverlayMotion / kBackgroundRange, 2);
    fit_.emplace(image, intensity, region, parameters_, radius_, model);
  }
}

void RegionTemplate::learnAgain(const cv::Mat& image, const Warp& warp)
{
  Uniform uniform(options_.seed + 1);
  coarse_.update(image, cv::Rect(cv::Point(), size_));
  learnLevels(image, warp, uniform, fit_ ? levels_.size() : levels_.size() - 1);
}

void RegionTemplate::placePoints(Uniform& uniform)
{
  points_.resize(options_.points, 2);
  for (Eigen::Index i = 0; i < points_.rows(); ++i)
  {
    points_(i, 0) = static_cast<float>(region_.x) + uniform(0.0, region_.width - 1.0);
    points_(i, 1) = static_cast<float>(region_.y) + uniform(0.0, region_.height - 1.0);
  }
  box_ = Box(points_.colwise().minCoeff().transpose(), points_.colwise().maxCoeff().transpose());
  sampled_.resize(points_.rows());
  outside_.resize(points_.rows());
  differences_.resize(points_.rows());
}

PixelMap RegionTemplate::pixelMap(const Warp& warp) const
{
  const Eigen::Vector2d offset = centre_ + warp.translation - warp.linear * centre_;
  const Eigen::Matrix2f linear = warp.linear.cast<float>();
  return { linear(0, 0), linear(0, 1), static_cast<float>(offset.x()),
           linear(1, 0), linear(1, 1), static_cast<float>(offset.y()) };
}

Nuisance RegionTemplate::nuisanceOf(const Eigen::ArrayXf& values) const
{
  const Eigen::MatrixXd shading = shadingPatterns(points_, region_);
  Eigen::MatrixXd patterns(points_.rows(), shading.cols() + 1);
  patterns << shading, values.matrix().cast<double>();
  return Nuisance(patterns);
}

RegionTemplate::Texture RegionTemplate::textureOf(const Eigen::ArrayXf& values, const Nuisance& nuisance) const
{
  Texture texture{ nuisance.basis(), nuisance.basis().rightCols<1>().dot(values.matrix()) };
  if (texture.contrast < 0.f)
  {
    texture.contrast = -texture.contrast;
    texture.nuisance.rightCols<1>() *= -1.f;
  }
  return texture;
}

void RegionTemplate::learnLevels(const cv::Mat& image, const Warp& warp, Uniform& uniform, std::size_t count)
{
  sample(image, warp);
  const Eigen::ArrayXf values = sampled_;
  const Nuisance nuisance = nuisanceOf(values);
  const Texture texture = textureOf(values, nuisance);
  coefficients_.resize(texture.nuisance.cols());
  const float deviation = texture.contrast / std::sqrt(static_cast<float>(points_.rows()));

  Eigen::MatrixXf motions(options_.training_motions, parameters_);
  Eigen::MatrixXf changes(points_.rows(), options_.training_motions);
  Level background;
  background.range = kBackgroundRange;
  background.values = values;
  simulate(image, warp, background, uniform, motions, changes);
  nuisance.removeFrom(changes);
  model_.background = options_.background * changes.squaredNorm() / static_cast<double>(changes.size());
  Eigen::MatrixXf covariance = static_cast<float>(model_.background) * backgroundCovariance(points_, nuisance);
  covariance.diagonal().array() += static_cast<float>(2.0 * bin_noise_);
  for (std::size_t i = 0; i < count; ++i)
  {
    Level& level = levels_[i];
    const bool decides = !options_.whole_region && i + 1 == levels_.size();
    level.values = values;
    level.limit = decides ? 0.f : kFullDifference * deviation;
    simulate(image, warp, level, uniform, motions, changes);
    // Beside large translations the rest can hardly be told: what the first predictor said of it would be noise.
    const bool coarsest = i == 0 && levels_.size() > 1;
    level.predictor = learnPredictor(changes, motions.leftCols(coarsest ? 2 : parameters_), covariance, nuisance);
  }
}

void RegionTemplate::simulate(const cv::Mat& image, const Warp& warp, const Level& level, Uniform& uniform,
                              Eigen::MatrixXf& motions, Eigen::MatrixXf& changes)
{
  const double range = static_cast<double>(level.range);
  const double share = std::sqrt(range / options_.ranges.front());
  const double rotation = share * radius_ * options_.rotation_range * M_PI / 180.0;
  const double scale = share * radius_ * options_.scale_range;
  const double limits[kMaxParameters] = { range, range, rotation, scale, scale, scale };
  for (Eigen::Index j = 0; j < motions.rows(); ++j)
  {
    for (int k = 0; k < parameters_; ++k)
    {
      motions(j, k) = uniform(-limits[k], limits[k]);
    }
    compare(level, sample(image, warp.after(Warp::exponential(motions.row(j).transpose(), radius_))));
    changes.col(j) = differences_;
  }
}

void RegionTemplate::look(const cv::Mat& image, const Warp& start)
{
  const Eigen::Vector2d half =
      0.75 * Eigen::Vector2d(region_.width, region_.height).array() + 1.5 * options_.ranges.front();
  const Eigen::Vector2d limit(1e6, 1e6);  // of what an integer holds, wherever the search has gone
  const Eigen::Vector2d corner = (centre_ + start.translation - half).cwiseMax(-limit).cwiseMin(limit);
  coarse_.update(image, cv::Rect(static_cast<int>(corner.x()), static_cast<int>(corner.y()),
                                 static_cast<int>(2.0 * half.x()), static_cast<int>(2.0 * half.y())));
}

int RegionTemplate::sample(const cv::Mat& image, const Warp& warp)
{
  const IntensityModel intensity = coarse_.intensity(intensity_);
  const PixelMap map = pixelMap(warp);
  const int outside = samplePoints(coarse_.pixels(), Sampling::BILINEAR, intensity, points_, box_, coarse_.toBins(map),
                                   sampled_, outside_);
  if (outside == 0 || coarse_.isWhole())
  {
    return outside;
  }
  coarse_.update(image, cv::Rect(cv::Point(), size_));
  return samplePoints(coarse_.pixels(), Sampling::BILINEAR, intensity, points_, box_, coarse_.toBins(map), sampled_,
                      outside_);
}

void RegionTemplate::compare(const Level& level, int outside)
{
  differences_ = (sampled_ - level.values).matrix();
  auto differences = differences_.array();
  if (outside > 0)
  {
    const float inside = static_cast<float>(points_.rows() - outside);
    const float mean = inside > 0.f ? (differences * (1.f - outside_)).sum() / inside : 0.f;
    differences = differences * (1.f - outside_) + mean * outside_;
  }
  if (level.limit > 0.f)
  {
    // What covers a part of the region must not outweigh the rest. First the middle of what is not covered; a pass
    // takes it nearer by the limit's half at least, if no more than a quarter is covered.
    for (int pass = 0; pass < kMiddlePasses; ++pass)
    {
      const float step = (differences - middle_).max(-level.limit).min(level.limit).mean();
      middle_ += step;
      if (std::abs(step) < 0.05f * level.limit)
      {
        break;
      }
    }
    const float fall = 1.f / (level.limit * (kNoDifference / kFullDifference - 1.f));
    differences -= middle_;
    differences = differences.max(-level.limit).min(level.limit) *
                  (1.f - fall * (differences.abs() - level.limit).max(0.f)).max(0.f);
  }
}

bool RegionTemplate::descend(const cv::Mat& image, const Level& level, float tolerance, SearchResult& result)
{
  Parameters answer(level.predictor.cols());
  BroydenSteps steps(answer.size(), level.range);
  float length = 0.f;
  for (int k = 0; k < options_.max_iterations; ++k)
  {
    const int outside = sample(image, result.warp);
    if (outside > kMaxOutside * static_cast<double>(points_.rows()))
    {
      result.status = TrackResult::Status::OUT_OF_IMAGE;
      return false;
    }
    compare(level, outside);
    for (Eigen::Index i = 0; i < answer.size(); ++i)
    {
      answer[i] = dot(level.predictor.col(i).data(), differences_.data(), differences_.size());
    }
    const Parameters& step = steps.next(answer);
    result.warp = result.warp.after(Warp::exponential(step, radius_));
    ++result.iterations;
    length = answer.norm();
    if (std::max(step.norm(), length) < tolerance)
    {
      return true;
    }
  }
  // Another predictor or the last steps may still succeed; whether this one's answer may be the result:
  return length < tolerance;
}

void RegionTemplate::fit(const cv::Mat& image, SearchResult& result)
{
  BroydenSteps steps(parameters_, kFitRange);
  const auto noiseFor = [](double evidence) { return evidence > 0.0 ? RegionFit::OVERLAY : RegionFit::WHITE; };
  RegionFit::Noise noise = noiseFor(evidence_);
  bool assessed = false;
  result.status = TrackResult::Status::DIVERGED;
  for (int k = 0; k < kMaxFits; ++k)
  {
    double inside;
    const RegionFit::Motions& motions = fit_->solve(image, intensity_, pixelMap(result.warp), inside);
    ++result.iterations;
    if (inside < 1.0 - kMaxOutside)
    {
      result.status = TrackResult::Status::OUT_OF_IMAGE;
      return;
    }
    Parameters step = steps.next(motions[noise]);
    const float length = motions[noise].norm();
    const bool is_last = k + 1 == kMaxFits;
    bool settled = std::max(step.norm(), length) < kFitConvergence;
    if (settled || is_last)
    {
      const RegionFit::Assessment& assessment = fit_->assess();
      if (!assessed)
      {
        assessed = true;
        // Exponential distributions, as chi-square's for two degrees of freedom is.
        const double ratio =
            assessment.disagreement * (1.0 / kAgreeing - 1.0 / kDisagreeing) - std::log(kDisagreeing / kAgreeing);
        result.evidence = std::clamp(evidence_ + ratio, -kMostEvidence, kMostEvidence);
        // Usually it is as in the last image. If not, the other motion is hardly more than its error away.
        const RegionFit::Noise other = noiseFor(result.evidence);
        if (other != noise && !is_last)
        {
          noise = other;
          settled = false;
          steps = BroydenSteps(parameters_, kFitRange);
          step = steps.next(motions[noise]);
        }
      }
      result.covariance = assessment.covariances[noise];
      result.correlation = assessment.correlation;
      result.share = assessment.share;
    }
    result.warp = result.warp.after(Warp::exponential(step, radius_));
    // In much noise there may be no place without an answer; one that is less than its error is as good.
    if (settled || (is_last && length < std::sqrt(result.covariance.trace())))
    {
      result.status = TrackResult::Status::TRACKED;
      return;
    }
  }
}

void RegionTemplate::judgePoints(SearchResult& result)
{
  // The last differences, taken a step of no consequence before the end, split into nuisance and the rest.
  coefficients_.noalias() = texture_.nuisance.transpose() * differences_;
  differences_.noalias() -= texture_.nuisance * coefficients_;
  const float count = static_cast<float>(points_.rows());
  const float floor = static_cast<float>(bin_noise_);
  // An image without content must not correlate by its rounding errors.
  const float residual = std::max(differences_.squaredNorm(), 0.01f * count * floor);
  const float found = coefficients_[coefficients_.size() - 1] + texture_.contrast;
  result.correlation = found / std::sqrt(found * found + residual);
  const float variance = residual / (count - static_cast<float>(coefficients_.size()));
  const Predictor& predictor = levels_.back().predictor;
  for (Eigen::Index i = 0; i < predictor.cols(); ++i)
  {
    for (Eigen::Index j = 0; j < predictor.cols(); ++j)
    {
      result.covariance(i, j) = variance * predictor.col(i).dot(predictor.col(j));
    }
  }
}

SearchResult RegionTemplate::search(const cv::Mat& image, const Warp& start, std::size_t first_level)
{
  SearchResult result;
  result.warp = start;
  result.evidence = evidence_;
  result.covariance.setZero(parameters_, parameters_);
  bool converged = false;
  if (first_level < levels_.size())
  {
    look(image, start);
  }
  for (std::size_t i = first_level; i < levels_.size(); ++i)
  {
    const double next = i + 1 < levels_.size() ? options_.ranges[i + 1] : static_cast<double>(kFitRange);
    const bool decides = !fit_ && i + 1 == levels_.size();
    converged =
        descend(image, levels_[i], static_cast<float>(decides ? options_.convergence : kHandOver * next), result);
    if (result.status == TrackResult::Status::OUT_OF_IMAGE)
    {
      return result;
    }
  }
  if (fit_)
  {
    fit(image, result);
    return result;
  }
  judgePoints(result);
  if (!converged && std::sqrt(result.covariance.trace()) < options_.convergence)
  {
    result.status = TrackResult::Status::DIVERGED;
  }
  return result;
}
}  // namespace xray_tracking
