#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "coarse_image.h"
#include "point_sampler.h"
#include "predictor.h"
#include "region_fit.h"
#include "warp.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
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

/// What a search in one image has come to.
struct SearchResult
{
  TrackResult::Status status = TrackResult::Status::TRACKED;  ///< TRACKED, DIVERGED or OUT_OF_IMAGE
  Warp warp;
  ParameterCovariance covariance;  ///< of the motion's parameters
  double correlation = 0.0;
  double share = 1.0;  ///< of the region that counted
  /// That something over the target moves on its own, against that nothing does: the logarithm of the likelihoods'
  /// ratio, of this image and those before.
  double evidence = 0.0;
  int iterations = 0;
};

/// What HyperplaneTracker learns from a region, and how it finds it again.
class RegionTemplate
{
public:
  /// @throws std::invalid_argument saying that the region has too little contrast
  RegionTemplate(const cv::Mat& image, const cv::Rect& region, const HyperplaneTrackerOptions& options,
                 const IntensityModel& intensity);

  /// Learns the predictors anew from an image in which the region is at a warp. What decides in the end, the last steps
  /// or, without them, the finest predictor, stays that of the first image: errors do not add up.
  void learnAgain(const cv::Mat& image, const Warp& warp);

  /// @param first_level of the predictors; past the last one, which needs `whole_region`, only the last steps are done.
  /// No allocation.
  SearchResult search(const cv::Mat& image, const Warp& start, std::size_t first_level);

  /// What a search has found is the region: the next ones go on from its evidence.
  void believe(const SearchResult& found) { evidence_ = found.evidence; }

  double radius() const { return radius_; }
  int parameters() const { return parameters_; }
  std::size_t levels() const { return levels_.size(); }

private:
  /// One predictor with the template that it was learnt from.
  struct Level
  {
    float range = 0.f;      ///< [px]
    Eigen::ArrayXf values;  ///< at the points
    float limit = 0.f;      ///< of a difference from the middle of all; 0: none
    Predictor predictor;    ///< A^T
  };
  /// The template at the points as the one pattern that tells how well something looks like it.
  struct Texture
  {
    Eigen::MatrixXf nuisance;  ///< orthonormal; the last column is the template without the shading of those before
    float contrast = 0.f;      ///< norm of the template without shading
  };

  void placePoints(Uniform& uniform);
  PixelMap pixelMap(const Warp& warp) const;
  Nuisance nuisanceOf(const Eigen::ArrayXf& values) const;
  Texture textureOf(const Eigen::ArrayXf& values, const Nuisance& nuisance) const;
  void learnLevels(const cv::Mat& image, const Warp& warp, Uniform& uniform, std::size_t count);
  void simulate(const cv::Mat& image, const Warp& warp, const Level& level, Uniform& uniform, Eigen::MatrixXf& motions,
                Eigen::MatrixXf& changes);

  /// Bins what a search from a start will look at.
  void look(const cv::Mat& image, const Warp& start);
  /// Samples at a warp into sampled_. @return number of points outside the image
  int sample(const cv::Mat& image, const Warp& warp);
  /// Differences of sampled_ from a level's template into differences_. @param outside number of points
  void compare(const Level& level, int outside);
  bool descend(const cv::Mat& image, const Level& level, float tolerance, SearchResult& result);
  void fit(const cv::Mat& image, SearchResult& result);
  void judgePoints(SearchResult& result);

  HyperplaneTrackerOptions options_;
  IntensityModel intensity_;
  cv::Size size_;
  cv::Rect region_;
  Eigen::Vector2d centre_;
  double radius_;  ///< root mean square distance of the region's pixels from its centre [px]
  int parameters_;
  CoarseImage coarse_;
  Points points_;
  Box box_;
  DifferenceModel model_;
  double bin_noise_ = 0.0;  ///< variance of the noise in the bins
  std::vector<Level> levels_;
  Texture texture_;               ///< of the finest level
  std::optional<RegionFit> fit_;  ///< the last steps
  double evidence_;               ///< SearchResult::evidence of the last image

  // Scratch memory of search().
  Eigen::ArrayXf sampled_;
  Eigen::ArrayXf outside_;
  Eigen::VectorXf differences_;
  float middle_ = 0.f;  ///< of the last differences, where the next ones' is looked for
  Eigen::VectorXf coefficients_;
};
}  // namespace xray_tracking
