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
/// How much farther than a map the image is taken in: steps are no longer than that [px].
constexpr int kFurther = 4;
}  // namespace

void RegionFit::look(const cv::Mat& image)
{
  image_ = image;
  spline_image_.clear();
}

bool RegionFit::cover(const PixelMap& map)
{
  // Groups reach as far beyond the points as they are filled up.
  Box box = box_;
  box.max().x() += static_cast<float>((kGroup - 1) * step_);
  Box seen;
  for (const auto corner : { Box::BottomLeft, Box::BottomRight, Box::TopLeft, Box::TopRight })
  {
    const Eigen::Vector2f p = box.corner(corner);
    seen.extend(Eigen::Vector2f(map.xx * p.x() + map.xy * p.y() + map.x0, map.yx * p.x() + map.yy * p.y() + map.y0));
  }
  constexpr float kFarthest = 1e6f;
  // Written so that NaN is far, too.
  if (!(seen.min().minCoeff() > -kFarthest && seen.max().maxCoeff() < kFarthest))
  {
    return false;
  }
  const float drift = static_cast<float>(kGroup * step_) * std::max(std::abs(map.xx - 1.f), std::abs(map.yx));
  const int margin = 4 + static_cast<int>(std::min(drift, kFarthest));
  const cv::Rect part(cv::Point(static_cast<int>(std::floor(seen.min().x())) - margin,
                                static_cast<int>(std::floor(seen.min().y())) - margin),
                      cv::Point(static_cast<int>(std::ceil(seen.max().x())) + margin,
                                static_cast<int>(std::ceil(seen.max().y())) + margin));
  if ((part & spline_image_.part()) == part)
  {
    return true;
  }
  return spline_image_.update(
      image_, cv::Rect(part.x - kFurther, part.y - kFurther, part.width + 2 * kFurther, part.height + 2 * kFurther));
}

double RegionFit::weighOutside(const PixelMap& map)
{
  const auto is_outside = [&](float x, float y)
  {
    const float column = map.xx * x + map.xy * y + map.x0;
    const float row = map.yx * x + map.yy * y + map.y0;
    return !(column >= 0.f && row >= 0.f && column <= static_cast<float>(image_.cols - 1) &&
             row <= static_cast<float>(image_.rows - 1));
  };
  const auto all = { Box::BottomLeft, Box::BottomRight, Box::TopLeft, Box::TopRight };
  if (std::none_of(all.begin(), all.end(),
                   [&](auto corner) { return is_outside(box_.corner(corner).x(), box_.corner(corner).y()); }))
  {
    return 1.0;
  }
  Eigen::Index outside = 0, count = 0;
  for (std::size_t t = 0; t < tiles_.size(); ++t)
  {
    const Tile& tile = tiles_[t];
    Eigen::Index of_tile = 0;
    for (Eigen::Index row = 0; row < tile.rows; ++row)
    {
      for (Eigen::Index i = tile.begin + row * tile.row_length, end = i + tile.width; i < end; ++i)
      {
        of_tile += is_outside(points_(i, 0), points_(i, 1));
      }
    }
    weights_[static_cast<Eigen::Index>(t)] = of_tile > 0 ? 0.f : 1.f;
    outside += of_tile;
    count += tile.count();
  }
  return 1.0 - static_cast<double>(outside) / static_cast<double>(count);
}

void RegionFit::sumTiles()
{
  const float* column = columns_.data();
  for (std::size_t t = 0; t < tiles_.size(); ++t)
  {
    const Tile& tile = tiles_[t];
    tile.clearPadding(sampled_);
    const float* differences = sampled_.data() + tile.begin;
    float* sums = sums_.col(static_cast<Eigen::Index>(t)).data();
    const int count = 2 * parameters_ + kShadings;
    dots(column, count, differences, tile.padded(), sums);
    sums[count] = dot(differences, differences, tile.padded());
    column += count * tile.padded();
  }
}

const RegionFit::Motions& RegionFit::solve(const PixelMap& map, double& inside)
{
  if (!cover(map))
  {
    inside = 0.0;
    return motions_;
  }
  sampleSpline(spline_image_.source(), group_x_.data(), group_y_.data(), group_x_.size(), spline_image_.toPart(map),
               sampled_.data());
  if (intensity_.kind == IntensityModel::Kind::COUNTS)
  {
    attenuate(sampled_.data(), sampled_.size(), static_cast<float>(intensity_.offset));
  }
  sampled_ -= values_;
  sumTiles();
  weights_.setOnes();
  inside = weighOutside(map);
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
    variances_[t] = sums_(2 * parameters_, t) / static_cast<float>(tiles_[static_cast<std::size_t>(t)].count());
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

ParameterCovariance RegionFit::scatter()
{
  // The sums over all squares of two by two tiles, each square a quarter: of two neighbours a half of their product
  // counts, a quarter where they only share a corner. So, with both directions one after the other:
  const Eigen::Index columns = tile_columns_, tiles = contributions_.rows();
  around_ = contributions_;
  for (Eigen::Index first = 0; first < tiles; first += columns)
  {
    const auto row = contributions_.middleRows(first, columns);
    around_.middleRows(first, columns - 1) += 0.5 * row.bottomRows(columns - 1);
    around_.middleRows(first + 1, columns - 1) += 0.5 * row.topRows(columns - 1);
  }
  ParameterCovariance scatter = contributions_.transpose() * around_;
  const ParameterCovariance across =
      contributions_.topRows(tiles - columns).transpose() * around_.bottomRows(tiles - columns);
  scatter += 0.5 * (across + across.transpose());
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
                    static_cast<float>(tiles_[static_cast<std::size_t>(t)].count());
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
  const auto solving = inverse_[noise].topRows(p);  // the equations for m
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    const Unknowns score = right(noise, t) - noise_scores_[noise].col(t) - product_.segment(t * q, q).cast<double>();
    contributions_.row(t).noalias() = static_cast<double>(weights_[t]) * (solving * score).transpose();
  }
  // So many tiles that tell as much as these would tell if all told the same.
  const auto told = information_[noise] * weights_.cast<double>();
  const double tiles = told.sum() * told.sum() / std::max(told.square().sum(), 1e-30);
  // What one of them tells of the motion, as measured, has gone
  // into it, and is not left in their residuals. Their sums are as good as independent ones of 1 / 2.25 of the tiles'
  // number; of so few, the inverse of the displacement's covariance is too large.
  const double independent = tiles / 2.25;
  const double freedom =
      tiles / std::max(1.0, tiles - 1.0) * independent / std::max(1.0, independent - 3.0) / noise_seen_;
  const System of_white = solving * all_squares_[noise] * solving.transpose();
  return freedom * (scatter() + missing * of_white);
}

const RegionFit::Assessment& RegionFit::assess()
{
  const int q = unknowns_;
  double residual = 0.0, texture = 0.0, counted = 0.0, all = 0.0;
  for (Eigen::Index t = 0; t < weights_.size(); ++t)
  {
    const double w = static_cast<double>(weights_[t]);
    const double count = static_cast<double>(tiles_[static_cast<std::size_t>(t)].count());
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
