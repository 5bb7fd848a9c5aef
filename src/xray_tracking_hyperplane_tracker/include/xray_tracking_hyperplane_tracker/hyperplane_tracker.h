#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// How a template is learnt and followed.
struct HyperplaneTrackerOptions
{
  /// Template points, uniformly random in the region; 50..20000.
  int points = 600;
  /// Largest trained motion of every predictor, coarse to fine [px]; > 0, falling.
  std::vector<double> ranges{ 30.0, 12.0, 4.0, 1.5 };
  /// Random motions that a predictor is learnt from; 50..100000.
  int training_motions = 1200;
  /// Weight of white noise beside the trained motions' grey-value changes; > 0.
  double ridge = 1e-3;
  /// Weight of the overlay that moves on its own (see HyperplaneTracker): its grey-value changes beside those of the
  /// finest range's motions; >= 0. From 0.1 to 10 the results hardly differ.
  double background = 1.0;
  /// Steps of eq. (1) a predictor; >= 1.
  int max_iterations = 20;
  /// A step shorter than this ends the iteration [px]; > 0.
  double convergence = 0.05;
  /// Below this correlation the region is lost; 0..1.
  double min_correlation = 0.65;
  /// A lost region is found again above this correlation; min_correlation..1.
  double found_correlation = 0.75;
  /// A region is refused if noise alone would move the estimate by more [px]; > 0.
  double max_predicted_sd = 0.3;
  /// The same seed gives the same points and motions.
  std::uint32_t seed = 1;

  /// @throws std::invalid_argument naming the option, its value and what was expected
  void validate() const;
};

/// What was found in one image.
struct TrackResult
{
  enum class Status
  {
    TRACKED,          ///< displacement and covariance are valid
    LOW_CORRELATION,  ///< what was found does not look like the template
    DIVERGED,         ///< the steps of eq. (1) did not become short
    OUT_OF_IMAGE      ///< more than a quarter of the template points lie outside the image
  };

  Status status = Status::TRACKED;
  /// Where the region is, less where it was in the template's image [px]: what was at x is now at x + displacement.
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();
  /// Of the displacement [px^2], from the residual's variance and the predictor's sensitivity to white noise.
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  double correlation = 0.0;  ///< of the template and what was found, both without slow shading; -1..1
  int iterations = 0;        ///< of eq. (1), all predictors
};

/// Follows a region of an X-ray image by hyperplanes (Jurie and Dhome 2002), translation only.
///
/// Values: detector counts are turned into attenuation, -log(counts - offset), because what lies behind one another
/// adds there; the counts behind air only add a constant. Images of attenuation are used as they are.
///
/// Training: random motions m_j within a range shift the points x_i within the template's image; the grey-value
/// differences they cause, d_ij = f0(x_i + m_j) - f0(x_i), are regressed onto the motions, A = argmin sum |m_j - A
/// d_j|^2 (least squares with a prior, below), one predictor A a range.
///
/// Tracking, eq. (1): with the current displacement m, the difference i = f(x + m) - f0(x) is what the template would
/// give at m less the true displacement, hence m <- m - A i; predictors coarse to fine, each until its steps are short.
///
/// What must not move the estimate is taken out in the training, so that it costs nothing later:
/// - brightness, contrast and slow shading: A times a constant, the template itself and the polynomials up to second
///   order in the region's coordinates is zero;
/// - what lies in front of and behind the target and moves otherwise: its difference image is smooth, a random field
///   whose variance grows with distance (generalised covariance -|x_i - x_j|, power spectrum 1/f^3 as soft tissue has
///   it). Added to the normal equations beside the white noise of the ridge, it makes A a whitening filter that weighs
///   what is small and sharp, the bone.
/// Finally A is scaled to answer small motions of the template by exactly these motions, on average over the range.
///
/// While lost, the search goes on from the last good place. Not thread-safe; track() does not allocate.
class HyperplaneTracker
{
public:
  /// @throws std::invalid_argument, see HyperplaneTrackerOptions::validate
  explicit HyperplaneTracker(const HyperplaneTrackerOptions& options, const IntensityModel& intensity = {});
  ~HyperplaneTracker();
  HyperplaneTracker(HyperplaneTracker&&) noexcept;
  HyperplaneTracker& operator=(HyperplaneTracker&&) noexcept;

  /// Learns a new template; the displacement starts again at zero.
  /// @param image CV_8UC1 or CV_16UC1; @param region [px], inside the image, 16 px or more in both directions
  /// @throws std::invalid_argument saying what is wrong with the image or the region (outside the image, too small, or
  /// without contrast: noise alone would move the estimate by more than max_predicted_sd); an earlier template stays.
  void train(const cv::Mat& image, const cv::Rect& region);

  /// Forgets the template.
  void reset();

  bool trained() const { return template_ != nullptr; }
  /// The template's region in its image; empty if there is no template.
  cv::Rect region() const;

  /// Finds the template. @param image of the template's size and type
  /// @throws std::invalid_argument naming both sizes and types if they differ; std::logic_error without a template
  const TrackResult& track(const cv::Mat& image);

  /// The last result of track(); zero displacement after training.
  const TrackResult& result() const { return result_; }

private:
  struct Template;

  HyperplaneTrackerOptions options_;
  IntensityModel intensity_;
  std::unique_ptr<Template> template_;
  Eigen::Vector2f last_good_ = Eigen::Vector2f::Zero();
  bool lost_ = false;
  TrackResult result_;
};
}  // namespace xray_tracking
