#pragma once

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
/// parameters, N the nuisance patterns (shading and the template itself), the noise white plus an overlay with the
/// spectrum 1/f^3. With instruments Z = P W J, W the inverse of the noise's covariance (a filter, by cosine transforms)
/// and P the projection that takes N out, m and n solve [Z N]^T (d - J m - N n) = 0: generalised least squares.
///
/// All sums are kept by tiles of the region. A tile whose residual is larger than the median of all, more than noise
/// and a small error of the motion explain, loses weight, and m is found anew from the tiles' sums, without going
/// through the pixels again. The scatter of the contributions of tiles and their neighbours to the equations gives the
/// covariance of m, whatever the residual's correlation over such distances.
class RegionFit
{
public:
  struct Solution
  {
    Parameters motion;  ///< m: of where the region was looked for relative to where it is
    ParameterCovariance covariance;
    double correlation = 0.0;  ///< of the template and what was found in the tiles that count, without shading
    double share = 0.0;        ///< of the region that counts, 0..1
    /// Mean square of the tiles' residual sums in units of what the residual's variance would make of them: about 1.4 for
    /// white noise (bilinear sampling lowers variances, not sums), more for an overlay.
    double unevenness = 0.0;
    double inside = 0.0;       ///< share of the region inside the image, 0..1
  };

  /// @param parameters of the motion model; @param radius see Parameters
  RegionFit(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& region, int parameters,
            double radius, const DifferenceModel& model);

  /// @return the solution for the image under a map of the region to it; no allocation
  const Solution& solve(const cv::Mat& image, const IntensityModel& intensity, const PixelMap& map);

private:
  static constexpr int kShadings = 7;  ///< nuisance patterns: shading and the template
  static constexpr int kMaxUnknowns = kMaxParameters + kShadings;
  using System = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxUnknowns, kMaxUnknowns>;
  using Unknowns = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxUnknowns, 1>;

  struct Tile
  {
    Eigen::Index begin = 0;   ///< of its points
    Eigen::Index padded = 0;  ///< number of points with the padding to whole vectors
    Eigen::Index count = 0;   ///< without
  };

  void layTiles(const cv::Rect& region);
  void sumTiles();
  void doubtCoveredTiles();
  void reweight();
  System scoreScatter() const;

  int parameters_;
  int unknowns_;  ///< parameters and nuisance patterns
  int step_;      ///< distance of sampled pixels [px]
  cv::Size grid_;
  double floor_;  ///< least variance of a residual

  std::vector<Tile> tiles_;  ///< row by row
  Eigen::Index tile_columns_ = 0;
  Points points_;
  Box box_;
  Eigen::ArrayXf values_;
  float contrast_ = 0.f;
  Eigen::VectorXf columns_;      ///< tile after tile: Z, J, N, column after column
  Eigen::MatrixXf normal_;       ///< tile after tile: [Z N]^T [J N]
  Eigen::MatrixXf energy_;       ///< tile after tile: [J N]^T [J N]
  Eigen::MatrixXd all_normal_;   ///< sum of normal_ over all tiles
  Eigen::MatrixXd all_squares_;  ///< [Z N]^T [Z N], over all tiles
  Eigen::ArrayXd information_;  ///< a tile's share of what is known of the motion
  Eigen::ArrayXf tolerance_;     ///< variance that a small error of the motion makes in a tile

  Eigen::ArrayXf sampled_;
  Eigen::ArrayXf outside_;
  Eigen::MatrixXf sums_;  ///< a column a tile: Z^T d, J^T d, N^T d, d^T d
  Eigen::ArrayXf weights_;
  Eigen::ArrayXf variances_;
  Eigen::ArrayXf sorted_;
  Eigen::VectorXf product_;
  Eigen::MatrixXd scores_;  ///< a column a tile: its weighted part of the equations
  Eigen::VectorXf unknown_;
  Solution solution_;
};
}  // namespace xray_tracking
