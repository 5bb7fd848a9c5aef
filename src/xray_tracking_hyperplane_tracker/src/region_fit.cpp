#include "region_fit.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

namespace xray_tracking
{
namespace
{
/// A tile counts in full up to this many times the median residual's variance; noise alone does not get there.
constexpr float kOutlier = 2.f;
/// A tile's mean this many times the median of all means away from the middle is far.
constexpr float kFarMean = 4.f;
constexpr int kReweightings = 6;
}  // namespace

void RegionFit::sumTiles()
{
  const float* column = columns_.data();
  for (std::size_t t = 0; t < tiles_.size(); ++t)
  {
    const Tile& tile = tiles_[t];
    float* differences = sampled_.data() + tile.begin;
    std::fill(differences + tile.count, differences + tile.padded, 0.f);
    float* sums = sums_.col(static_cast<Eigen::Index>(t)).data();
    const int count = 2 * parameters_ + kShadings;
    dots(column, count, differences, tile.padded, sums);
    sums[count] = dot(differences, differences, tile.padded);
    column += count * tile.padded;
  }
}

const RegionFit::Motions& RegionFit::solve(const cv::Mat& image, const IntensityModel& intensity, const PixelMap& map,
                                           double& inside)
{
  const int outside = samplePoints(image, Sampling::SPLINE, intensity, points_, box_, map, sampled_, outside_);
  inside = 1.0 - static_cast<double>(outside) / static_cast<double>(points_.rows());
  sampled_ -= values_;
  sumTiles();
  weights_.setOnes();
  for (std::size_t t = 0; outside > 0 && t < tiles_.size(); ++t)
  {
    if (outside_.segment(tiles_[t].begin, tiles_[t].padded).maxCoeff() > 0.f)
    {
      weights_[static_cast<Eigen::Index>(t)] = 0.f;
    }
  }
  doubtCoveredTiles();
  reweight();
  solveWeighted(WHITE);
  for (const Noise noise : { WHITE, OVERLAY })
  {
    motions_[noise] = unknown_[noise].head(parameters_).cast<float>();
  }
  return motions_;
}

void RegionFit::doubtCoveredTiles()
{
  // Something large can make the first, unweighted solution so wrong that all tiles look alike. It shows in the tiles'
  // means before: those that are far from the middle of all start with little weight, to be given back if they fit.
  const Eigen::Index tiles = weights_.size();
  const auto middle = [this, tiles]
  {
    std::nth_element(sorted_.data(), sorted_.data() + tiles / 2, sorted_.data() + tiles);
    return sorted_[tiles / 2];
  };
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    // The first nuisance pattern is the constant.
    variances_[t] = sums_(2 * parameters_, t) / static_cast<float>(tiles_[static_cast<std::size_t>(t)].count);
  }
  sorted_ = variances_;
  variances_ -= middle();
  sorted_ = variances_.abs();
  const float far = kFarMean * middle();
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    const float ratio = far / std::max(std::abs(variances_[t]), 1e-30f);
    weights_[t] *= ratio < 1.f ? std::max(1e-6f, ratio * ratio * ratio * ratio) : 1.f;
  }
}

RegionFit::System RegionFit::scoreScatter() const
{
  // Over all squares of two by two tiles, those that reach over the region's border too: every tile is in four.
  System scatter = System::Zero(unknowns_, unknowns_);
  Unknowns sum(unknowns_);
  const Eigen::Index rows = scores_.cols() / tile_columns_;
  for (Eigen::Index r = 0; r <= rows; ++r)
  {
    for (Eigen::Index c = 0; c <= tile_columns_; ++c)
    {
      sum.setZero();
      for (Eigen::Index y = std::max<Eigen::Index>(0, r - 1); y <= std::min(r, rows - 1); ++y)
      {
        for (Eigen::Index x = std::max<Eigen::Index>(0, c - 1); x <= std::min(c, tile_columns_ - 1); ++x)
        {
          sum += scores_.col(y * tile_columns_ + x);
        }
      }
      scatter.noalias() += 0.25 * sum * sum.transpose();
    }
  }
  return scatter;
}

RegionFit::Unknowns RegionFit::right(Noise noise, Eigen::Index tile) const
{
  Unknowns sums(unknowns_);
  sums.head(parameters_) = sums_.col(tile).segment(noise * parameters_, parameters_).cast<double>();
  sums.tail<kShadings>() = sums_.col(tile).segment<kShadings>(2 * parameters_).cast<double>();
  return sums;
}

void RegionFit::solveWeighted(Noise noise)
{
  System system = all_normal_[noise];
  Unknowns sums = Unknowns::Zero(unknowns_);
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    const double w = static_cast<double>(weights_[t]);
    if (w != 1.0)
    {
      system.noalias() -= (1.0 - w) * normal_[noise].middleRows(t * unknowns_, unknowns_).cast<double>();
    }
    sums += w * right(noise, t);
  }
  inverse_[noise] = system.inverse();
  unknown_[noise].noalias() = inverse_[noise] * sums;
}

void RegionFit::findVariances()
{
  const int q = unknowns_;
  const UnknownsOfTiles unknown = unknown_[OVERLAY].cast<float>();
  product_.noalias() = normal_[WHITE] * unknown;
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    const float explained =
        unknown.dot(product_.segment(t * q, q)) - 2.f * static_cast<float>(unknown_[OVERLAY].dot(right(WHITE, t)));
    variances_[t] = std::max(0.f, sums_(sums_.rows() - 1, t) + explained) /
                    static_cast<float>(tiles_[static_cast<std::size_t>(t)].count);
  }
}

void RegionFit::reweight()
{
  for (int pass = 0; pass <= kReweightings; ++pass)
  {
    solveWeighted(OVERLAY);
    findVariances();
    Eigen::Index kept = 0;
    for (Eigen::Index t = 0; t < weights_.size(); ++t)
    {
      if (weights_[t] > 0.f)
      {
        sorted_[kept++] = variances_[t];
      }
    }
    if (kept == 0)
    {
      return;
    }
    std::nth_element(sorted_.data(), sorted_.data() + kept / 2, sorted_.data() + kept);
    const float scale = std::max(sorted_[kept / 2], static_cast<float>(floor_));
    float change = 0.f;
    for (Eigen::Index t = 0; pass < kReweightings && t < weights_.size(); ++t)
    {
      if (weights_[t] > 0.f)
      {
        const float ratio = (kOutlier * scale + tolerance_[t]) / std::max(variances_[t], 1e-30f);
        const float weight = std::max(1e-6f, std::min(1.f, ratio * ratio));
        change = std::max(change, std::abs(weight - weights_[t]));
        weights_[t] = weight;
      }
    }
    if (change < 0.02f)
    {
      return;
    }
  }
}

ParameterCovariance RegionFit::covariance(Noise noise, double missing)
{
  const int p = parameters_;
  const int q = unknowns_;
  const UnknownsOfTiles unknown = unknown_[noise].cast<float>();
  product_.noalias() = normal_[noise] * unknown;
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    scores_.col(t) = static_cast<double>(weights_[t]) *
                     (right(noise, t) - noise_scores_[noise].col(t) - product_.segment(t * q, q).cast<double>());
  }
  const System scatter = scoreScatter() + missing * all_squares_[noise];
  // So many tiles that tell as much as these would tell if all told the same.
  const auto told = information_[noise] * weights_.cast<double>();
  const double tiles = told.sum() * told.sum() / std::max(told.square().sum(), 1e-30);
  // What one of them tells of the motion, as measured, has gone
  // into it, and is not left in their residuals. Their sums are as good as independent ones of 1 / 2.25 of the tiles'
  // number; of so few, the inverse of the displacement's covariance is too large.
  const double independent = tiles / 2.25;
  const double freedom =
      tiles / std::max(1.0, tiles - 1.0) * independent / std::max(1.0, independent - 3.0) / noise_seen_;
  return freedom * (inverse_[noise] * scatter * inverse_[noise].transpose()).topLeftCorner(p, p);
}

const RegionFit::Assessment& RegionFit::assess()
{
  const int q = unknowns_;
  double residual = 0.0, texture = 0.0, counted = 0.0, all = 0.0;
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    const double w = static_cast<double>(weights_[t]);
    const double count = static_cast<double>(tiles_[static_cast<std::size_t>(t)].count);
    residual += w * static_cast<double>(variances_[t]) * count;
    texture += w * static_cast<double>(normal_[WHITE](t * q + q - 1, q - 1));
    counted += w * count;
    all += count;
  }
  // An image that is more like the template than noise allows is the template's own. It has no error, but whoever
  // weighs by covariances needs one.
  const double missing = std::max(0.0, floor_ - residual / std::max(counted, 1.0));
  for (const Noise noise : { WHITE, OVERLAY })
  {
    assessment_.covariances[noise] = covariance(noise, missing);
  }
  const double strength = (unknown_[OVERLAY][q - 1] + static_cast<double>(contrast_)) * std::sqrt(texture);
  assessment_.correlation = strength / std::sqrt(strength * strength + residual + 0.01 * counted * floor_);
  assessment_.share = counted / all;
  const Eigen::Vector2d difference = (motions_[WHITE] - motions_[OVERLAY]).head<2>().cast<double>();
  const Eigen::Matrix2d uncertainty = assessment_.covariances[OVERLAY].topLeftCorner<2, 2>();
  assessment_.disagreement = difference.dot(uncertainty.inverse() * difference);
  return assessment_;
}
}  // namespace xray_tracking
