#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
struct SearchResult;
struct Warp;

/// How a template is learnt and followed.
struct HyperplaneTrackerOptions
{
  MotionModel model = MotionModel::TRANSLATION;
  /// Edge of the squares of pixels whose means are tracked [px], 1..64, less where a region would have less than 32 of
  /// them: a fine detector takes no longer than a coarse one. All other lengths here are in squares of this edge [px],
  /// and mean the same where the edge is less; only `bin` is in the means that there are.
  int reduction = 1;
  /// Template points, uniformly random in the region; 50..20000, and so few that a training takes at most 1e9 bytes, 4
  /// points (training_motions + 4 points).
  int points = 400;
  /// Edge of the square bins of pixels whose means the points sample [px]; 1..16. 1: single pixels, as in the paper.
  int bin = 4;
  /// Largest trained translation of every predictor, coarse to fine [px]; > 0, up to 1000, falling.
  std::vector<double> ranges{ 40.0, 16.0, 5.0 };
  /// Largest trained rotation [deg], > 0 to 45, and relative change of scale and shear, > 0 to 0.5, of the coarsest
  /// predictor; used by models that have them. The finer predictors' are smaller as their translations are.
  double rotation_range = 8.0;
  double scale_range = 0.08;
  /// Random motions that a predictor is learnt from; 50..100000.
  int training_motions = 800;
  /// Weight of the overlay that moves on its own (see HyperplaneTracker): its grey-value changes beside those of
  /// motions by up to 1.5 px; 0..1000.
  double background = 1.0;
  /// Whether the last steps use all pixels of the region; else the predictors' answer is the result, as in the paper.
  bool whole_region = true;
  /// Steps of eq. (1) a predictor; 1..1000.
  int max_iterations = 20;
  /// A step shorter than this ends the predictors' iteration [px]; > 0.
  double convergence = 0.05;
  /// Below this correlation the region is lost; 0..1.
  double min_correlation = 0.65;
  /// A lost region is found again above this correlation; min_correlation..1.
  double found_correlation = 0.75;
  /// Below this quality (TrackResult) the region is lost too; 0..1.
  double min_quality = 0.5;
  /// Below this quality the region is found but degraded; min_quality..1.
  double good_quality = 0.6;
  /// A region is refused if noise alone would move the estimate by more [px]; > 0.
  double max_predicted_sd = 0.3;
  /// The same seed gives the same points and motions.
  std::uint32_t seed = 1;

  /// @throws std::invalid_argument naming the option, its value and what was expected
  void validate() const;
};

/// Follows a region of an X-ray image by hyperplanes (Jurie and Dhome 2002).
///
/// Values: detector counts are turned into attenuation, -log(counts - offset), because what lies behind one another
/// adds there; the counts behind air only add a constant. Images of attenuation are used as they are.
///
/// Training: random warps exp(m_j) within a range, exp of the motion model's group, move the points x_i within the
/// template's image; the grey-value differences they cause, d_ij = f0(exp(m_j) x_i) - f0(x_i), are regressed onto the
/// motions, A = argmin sum |m_j - A d_j|^2 (least squares with a prior, below), one predictor A a range. The coarsest
/// one answers translations only, whatever the model: beside large translations the rest can hardly be told.
///
/// Tracking, eq. (1): with the current warp W, the difference i = f(W x) - f0(x) is what the template would give at
/// m = log(W*^-1 W), W* the true warp, hence W <- W exp(-A i); predictors coarse to fine, each until its steps are
/// short. The last steps use all pixels of the region (`whole_region`): Gauss-Newton on the template's derivatives,
/// robust against what covers a part of the region, with a covariance from the scatter of the region's parts; for white
/// noise alone where what lies over the target is not seen to move otherwise.
///
/// What must not move the estimate is taken out in the training, so that it costs nothing later:
/// - brightness, contrast and slow shading: A times a constant, the template itself and the polynomials up to second
///   order in the region's coordinates is zero. (Normalising by mean and standard deviation, the alternative, has to be
///   done at every step, takes what covers a part of the region into its mean, and leaves shading in.)
/// - what lies in front of and behind the target and moves otherwise: its difference image is smooth, a random field
///   whose variance grows with distance (generalised covariance -|x_i - x_j|, power spectrum 1/f^3 as soft tissue has
///   it). Added to the normal equations beside the image's white noise, which is estimated, it makes A a whitening
///   filter that weighs what is small and sharp, the bone.
/// - what covers up to a quarter of the region: differences that the template can hardly cause count less, in training
///   as in tracking.
///
/// While lost, the search goes on from the last good place. Not thread-safe; track() does not allocate.
class HyperplaneTracker : public RegionTracker
{
public:
  /// @throws std::invalid_argument, see HyperplaneTrackerOptions::validate
  explicit HyperplaneTracker(const HyperplaneTrackerOptions& options, const IntensityModel& intensity = {});
  ~HyperplaneTracker() override;
  HyperplaneTracker(HyperplaneTracker&&) noexcept;
  HyperplaneTracker& operator=(HyperplaneTracker&&) noexcept;

  /// @throws also for a region without contrast: noise alone would move the estimate by more than max_predicted_sd
  void train(const cv::Mat& image, const cv::Rect& region) override;
  void reset() override;
  bool trained() const override { return state_ != nullptr; }
  cv::Rect region() const override;
  const TrackResult& track(const cv::Mat& image) override;
  const TrackResult& trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement) override;
  void setLost() override { lost_ = true; }
  const TrackResult& result() const override { return result_; }

  /// Tracks, and where the region is found learns the predictors anew from this image, for a region whose looks have
  /// changed. Displacements are still those from the first image, and what measures them in the end, the last steps or,
  /// without these, the finest predictor, is still learnt from it: errors do not add up over re-trainings.
  /// @return whether the region was found; else nothing is learnt
  bool retrain(const cv::Mat& image) override;

  /// From now on judges by these min_correlation, found_correlation, min_quality and good_quality; all else stays.
  /// @throws std::invalid_argument, see HyperplaneTrackerOptions::validate
  void setThresholds(const HyperplaneTrackerOptions& options);

private:
  class View;
  struct State;

  /// Finds the template from a start into result_. @param start displacement and linear part in the reduced image
  /// @param only_near not by the coarse predictors
  void search(const cv::Mat& image, const Warp& start, bool only_near);
  /// @param degraded whether the last result was
  TrackResult::Status judged(const SearchResult& found, bool degraded) const;
  void adopt(const SearchResult& found, TrackResult::Status status);

  HyperplaneTrackerOptions options_;
  IntensityModel intensity_;
  std::unique_ptr<State> state_;
  bool lost_ = false;
  TrackResult result_;
};
}  // namespace xray_tracking
