#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "point_sampler.h"
#include "spectral_filter.h"
#include "warp.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
constexpr double kMaxFitPixels = 2e4;  ///< of larger regions every second, third ... column and row is used

/// The last steps of the tracker: Gauss-Newton on all pixels of the region, robust against parts that do not look like
/// the template.
///
/// The differences d = f(warp(x)) - f0(x) are modelled as J m + N n + noise: J the template's derivatives by the motion
/// parameters, N the nuisance patterns (shading and the template itself), f0 and J from the template without its noise
/// and blurred as f is by its sampling (sampleSpline()). With instruments Z = P W J', P the projection that takes N
/// out, J' as J but not blurred, because d's noise is already, m and n solve [Z N]^T (d - J m - N n) = 0. There are two
/// solutions: with W = 1 for white noise alone, the best where nothing moves on its own, and with W the inverse of the
/// covariance of white noise and an overlay with the spectrum 1/f^3 (a filter, by cosine transforms), generalised least
/// squares, which such an overlay hardly moves. Where both agree within their errors, there is none (Hausman 1978).
///
/// All sums are kept by tiles of the region. A tile whose residual is larger than the median of all, more than noise
/// and a small error of the motion explain, loses weight, and m is found anew from the tiles' sums, without going
/// through the pixels again. The scatter of the contributions of tiles and their neighbours to the equations gives the
/// covariance of m, whatever the residual's correlation over such distances.
class RegionFit
{
public:
  /// For either kind of noise.
  enum Noise
  {
    WHITE,
    OVERLAY
  };
  /// m: of where the region was looked for relative to where it is.
  using Motions = std::array<Parameters, 2>;
  /// What there is to say about the last motions.
  struct Assessment
  {
    std::array<ParameterCovariance, 2> covariances;
    double correlation = 0.0;  ///< of the template and what was found in the tiles that count, without shading
    double share = 0.0;        ///< of the region that counts, 0..1
    /// Of both motions' translations, squared, in units of its variance; 1.4 in the median where nothing moves on its
    /// own.
    double disagreement = 0.0;
  };

  /// @param parameters of the motion model; @param radius see Parameters
  RegionFit(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& region, int parameters,
            double radius, const DifferenceModel& model);

  /// @param inside out, share of the region inside the image, 0..1
  /// @return the motions for the image under a map of the region to it; no allocation
  const Motions& solve(const cv::Mat& image, const IntensityModel& intensity, const PixelMap& map, double& inside);
  /// Of the last solve().
  const Assessment& assess();

private:
  static constexpr int kShadings = 7;  ///< nuisance patterns: shading and the template
  static constexpr int kMaxUnknowns = kMaxParameters + kShadings;
  using System = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxUnknowns, kMaxUnknowns>;
  using Unknowns = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxUnknowns, 1>;
  using UnknownsOfTiles = Eigen::Matrix<float, Eigen::Dynamic, 1, 0, kMaxUnknowns, 1>;

  struct Tile
  {
    Eigen::Index begin = 0;   ///< of its points
    Eigen::Index padded = 0;  ///< number of points with the padding to whole vectors
    Eigen::Index count = 0;   ///< without
  };

  /// @param noise_reach mean distance of pixels whose noise is alike [px]
  void layTiles(const cv::Rect& region, double noise_reach);
  /// @param slopes J without the patterns of N
  void store(const Eigen::MatrixXf& slopes, const std::array<Eigen::MatrixXf, 2>& instruments,
             const Eigen::MatrixXf& nuisance, const Eigen::VectorXf& template_noise);
  void sumTiles();
  void doubtCoveredTiles();
  void reweight();
  /// Solves for the weights as they are.
  void solveWeighted(Noise noise);
  /// Sums over a tile of [Z N]^T d.
  Unknowns right(Noise noise, Eigen::Index tile) const;
  /// The tiles' mean square residuals.
  void findVariances();
  System scoreScatter() const;
  /// @param missing of the residual's variance to what is the least
  ParameterCovariance covariance(Noise noise, double missing);

  int parameters_;
  int unknowns_;  ///< parameters and nuisance patterns
  int step_;      ///< distance of sampled pixels [px]
  cv::Size grid_;
  double floor_;             ///< least variance of a residual
  double noise_seen_ = 1.0;  ///< share of the white noise's scatter that squares of two by two tiles see

  std::vector<Tile> tiles_;  ///< row by row
  Eigen::Index tile_columns_ = 0;
  Points points_;
  Box box_;
  Eigen::ArrayXf values_;
  float contrast_ = 0.f;
  Eigen::VectorXf columns_;  ///< tile after tile: Z of both kinds, N, column after column
  /// Tile after tile, for either kind: [Z N]^T [J N], J without the patterns of N.
  std::array<Eigen::MatrixXf, 2> normal_;
  std::array<Eigen::MatrixXd, 2> all_normal_;   ///< sums of normal_ over all tiles
  std::array<Eigen::MatrixXd, 2> all_squares_;  ///< [Z N]^T [Z N], both the same Z, over all tiles
  /// A column a tile: [Z N]^T times the template's noise. It is not in f0, but its part of the error is as that of the
  /// other image's noise: the scatter has to have it.
  std::array<Eigen::MatrixXd, 2> noise_scores_;
  std::array<Eigen::ArrayXd, 2> information_;  ///< a tile's share of what is known of the motion
  Eigen::ArrayXf tolerance_;                   ///< variance that a small error of the motion makes in a tile

  Eigen::ArrayXf sampled_;
  Eigen::ArrayXf outside_;
  Eigen::MatrixXf sums_;  ///< a column a tile: Z^T d of both kinds, N^T d, d^T d
  Eigen::ArrayXf weights_;
  Eigen::ArrayXf variances_;
  Eigen::ArrayXf sorted_;
  Eigen::VectorXf product_;
  Eigen::MatrixXd scores_;           ///< a column a tile: its weighted part of the equations
  std::array<System, 2> inverse_;    ///< of the weighted equations' matrix
  std::array<Unknowns, 2> unknown_;  ///< m and n
  Motions motions_;
  Assessment assessment_;
};
}  // namespace xray_tracking
