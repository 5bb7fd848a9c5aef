#include "region_fit.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>
#include <opencv2/imgproc.hpp>

#include "predictor.h"
#include "spectral_filter.h"

namespace xray_tracking
{
namespace
{
constexpr int kLane = 8;          ///< floats in a vector
constexpr double kTiles = 100.0;  ///< about; enough for their scatter to be an estimate
/// A tile counts in full up to this many times the median residual's variance; noise alone does not get there.
constexpr float kOutlier = 2.f;
/// Error of the motion [px] whose residual does not make an outlier.
constexpr float kMotionError = 0.15f;
/// A tile's mean this many times the median of all means away from the middle is far.
constexpr float kFarMean = 4.f;
constexpr int kReweightings = 6;
}  // namespace

void RegionFit::layTiles(const cv::Rect& region)
{
  const double side = std::max(4.0, std::sqrt(grid_.area() / kTiles));
  const int columns = std::max(1, static_cast<int>(std::lround(grid_.width / side)));
  const int rows = std::max(1, static_cast<int>(std::lround(grid_.height / side)));
  tile_columns_ = columns;
  std::vector<Eigen::Vector2f> places;
  for (int r = 0; r < rows; ++r)
  {
    for (int c = 0; c < columns; ++c)
    {
      Tile tile;
      tile.begin = static_cast<Eigen::Index>(places.size());
      for (int y = r * grid_.height / rows; y < (r + 1) * grid_.height / rows; ++y)
      {
        for (int x = c * grid_.width / columns; x < (c + 1) * grid_.width / columns; ++x)
        {
          places.emplace_back(region.x + x * step_, region.y + y * step_);
        }
      }
      tile.count = static_cast<Eigen::Index>(places.size()) - tile.begin;
      while (places.size() % kLane != 0)
      {
        places.push_back(places.back());
      }
      tile.padded = static_cast<Eigen::Index>(places.size()) - tile.begin;
      tiles_.push_back(tile);
    }
  }
  points_.resize(static_cast<Eigen::Index>(places.size()), 2);
  for (Eigen::Index i = 0; i < points_.rows(); ++i)
  {
    points_.row(i) = places[static_cast<std::size_t>(i)].transpose();
  }
  box_ = Box(points_.colwise().minCoeff().transpose(), points_.colwise().maxCoeff().transpose());
}

RegionFit::RegionFit(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& region, int parameters,
                     double radius, const DifferenceModel& model)
  : parameters_(parameters),
    unknowns_(parameters + kShadings),
    step_(static_cast<int>(std::ceil(std::sqrt(region.area() / kMaxFitPixels)))),
    grid_(region.width / step_, region.height / step_),
    floor_(model.noise * model.noise)
{
  layTiles(region);
  const Eigen::Index n = points_.rows();
  values_.resize(n);
  sampled_.resize(n);
  outside_.resize(n);
  const PixelMap identity{ 1.f, 0.f, 0.f, 0.f, 1.f, 0.f };
  samplePoints(image, intensity, points_, box_, identity, values_, outside_);

  // Derivatives by the motion, on the grid for the filter.
  constexpr int kMargin = 16;
  cv::Mat smooth;
  const cv::Rect seen =
      cv::Rect(region.x - kMargin, region.y - kMargin, region.width + 2 * kMargin, region.height + 2 * kMargin) &
      cv::Rect(cv::Point(), image.size());
  smooth = withoutNoise(attenuationImage(image(seen), intensity), model.noise);
  cv::Mat gradient_x, gradient_y;
  cv::Sobel(smooth, gradient_x, CV_32F, 1, 0, 1, 0.5);
  cv::Sobel(smooth, gradient_y, CV_32F, 0, 1, 1, 0.5);
  const Eigen::Vector2d centre(region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1));
  const Whitening whitening(grid_, step_, model);
  Eigen::MatrixXf derivatives(n, parameters);
  Eigen::MatrixXf instruments(n, parameters);
  const auto on_grid = [&](Eigen::Index i)
  { return cv::Point(static_cast<int>(points_(i, 0)), static_cast<int>(points_(i, 1))); };
  for (int k = 0; k < parameters; ++k)
  {
    cv::Mat derivative(grid_, CV_32F);
    for (int y = 0; y < grid_.height; ++y)
    {
      for (int x = 0; x < grid_.width; ++x)
      {
        const cv::Point place(region.x + x * step_, region.y + y * step_);
        const Eigen::Vector2d motion =
            k < 2 ? Eigen::Vector2d::Unit(k)
                  : (generator(k) * (Eigen::Vector2d(place.x, place.y) - centre) / radius).eval();
        derivative.at<float>(y, x) = static_cast<float>(motion.x()) * gradient_x.at<float>(place - seen.tl()) +
                                     static_cast<float>(motion.y()) * gradient_y.at<float>(place - seen.tl());
      }
    }
    const cv::Mat instrument = whitening(derivative);
    for (Eigen::Index i = 0; i < n; ++i)
    {
      const cv::Point place = (on_grid(i) - region.tl()) / step_;
      derivatives(i, k) = derivative.at<float>(place);
      instruments(i, k) = instrument.at<float>(place);
    }
  }

  const Eigen::MatrixXd shading = shadingPatterns(points_, region);
  Eigen::MatrixXd patterns(n, kShadings);
  // The template's own noise would make all contrasts seem too low (regression dilution): without it.
  patterns.leftCols<kShadings - 1>() = shading;
  for (Eigen::Index i = 0; i < n; ++i)
  {
    patterns(i, kShadings - 1) = static_cast<double>(smooth.at<float>(on_grid(i) - seen.tl()));
  }
  for (const Tile& tile : tiles_)
  {
    patterns.middleRows(tile.begin + tile.count, tile.padded - tile.count).setZero();
    derivatives.middleRows(tile.begin + tile.count, tile.padded - tile.count).setZero();
    instruments.middleRows(tile.begin + tile.count, tile.padded - tile.count).setZero();
  }
  const Nuisance found(patterns);
  found.removeFrom(instruments);
  Eigen::MatrixXf nuisance = found.basis();
  contrast_ = nuisance.rightCols<1>().dot(patterns.rightCols<1>().cast<float>());
  if (contrast_ < 0.f)
  {
    contrast_ = -contrast_;
    nuisance.rightCols<1>() *= -1.f;
  }

  const Eigen::Index tiles = static_cast<Eigen::Index>(tiles_.size());
  columns_.resize(n * (2 * parameters + kShadings));
  normal_.resize(tiles * unknowns_, unknowns_);
  energy_.resize(tiles * unknowns_, unknowns_);
  all_normal_ = Eigen::MatrixXd::Zero(unknowns_, unknowns_);
  all_squares_ = Eigen::MatrixXd::Zero(unknowns_, unknowns_);
  tolerance_.resize(tiles);
  float* column = columns_.data();
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    const Tile& tile = tiles_[static_cast<std::size_t>(t)];
    Eigen::MatrixXf left(tile.padded, unknowns_), right(tile.padded, unknowns_);
    const auto rows = [&tile](const Eigen::MatrixXf& all) { return all.middleRows(tile.begin, tile.padded); };
    left << rows(instruments), rows(nuisance);
    right << rows(derivatives), rows(nuisance);
    Eigen::Map<Eigen::MatrixXf> stored(column, tile.padded, 2 * parameters + kShadings);
    stored << rows(instruments), right;
    column += stored.size();
    normal_.middleRows(t * unknowns_, unknowns_) = left.transpose() * right;
    energy_.middleRows(t * unknowns_, unknowns_) = right.transpose() * right;
    all_squares_ += (left.transpose() * left).cast<double>();
    all_normal_ += normal_.middleRows(t * unknowns_, unknowns_).cast<double>();
    tolerance_[t] =
        kMotionError * kMotionError * rows(derivatives).leftCols(2).squaredNorm() / static_cast<float>(tile.count);
  }

  information_.resize(tiles);
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    const Eigen::MatrixXd part = normal_.middleRows(t * unknowns_, unknowns_).cast<double>();
    information_[t] = (part.diagonal().array() / all_normal_.diagonal().array()).head(parameters).sum();
  }

  sums_.resize(2 * parameters + kShadings + 1, tiles);
  weights_.resize(tiles);
  variances_.resize(tiles);
  sorted_.resize(tiles);
  product_.resize(tiles * unknowns_);
  scores_.resize(unknowns_, tiles);
  unknown_.resize(unknowns_);
  solution_.motion.resize(parameters);
  solution_.covariance.resize(parameters, parameters);
}

void RegionFit::sumTiles()
{
  const float* column = columns_.data();
  for (std::size_t t = 0; t < tiles_.size(); ++t)
  {
    const Tile& tile = tiles_[t];
    float* differences = sampled_.data() + tile.begin;
    std::fill(differences + tile.count, differences + tile.padded, 0.f);
    float* sums = sums_.col(static_cast<Eigen::Index>(t)).data();
    for (int k = 0; k < 2 * parameters_ + kShadings; ++k, column += tile.padded)
    {
      *sums++ = dot(column, differences, tile.padded);
    }
    *sums = dot(differences, differences, tile.padded);
  }
}

const RegionFit::Solution& RegionFit::solve(const cv::Mat& image, const IntensityModel& intensity, const PixelMap& map)
{
  const int outside = samplePoints(image, intensity, points_, box_, map, sampled_, outside_);
  solution_.inside = 1.0 - static_cast<double>(outside) / static_cast<double>(points_.rows());
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
  return solution_;
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

void RegionFit::reweight()
{
  const int p = parameters_;
  const int q = unknowns_;
  const Eigen::Index tiles = weights_.size();
  System system(q, q);
  Unknowns right(q), found(q);
  System inverse(q, q);
  for (int pass = 0;; ++pass)
  {
    system = all_normal_;
    right.setZero();
    for (Eigen::Index t = 0; t < tiles; ++t)
    {
      const float w = weights_[t];
      if (w != 1.f)
      {
        system.noalias() -= static_cast<double>(1.f - w) * normal_.middleRows(t * q, q).cast<double>();
      }
      right.head(p) += static_cast<double>(w) * sums_.col(t).head(p).cast<double>();
      right.tail<kShadings>() += static_cast<double>(w) * sums_.col(t).segment<kShadings>(2 * p).cast<double>();
    }
    inverse = system.inverse();
    found.noalias() = inverse * right;
    unknown_ = found.cast<float>();
    product_.noalias() = energy_ * unknown_;
    Eigen::Index kept = 0;
    for (Eigen::Index t = 0; t < tiles; ++t)
    {
      const float explained = unknown_.dot(product_.segment(t * q, q)) - 2.f * unknown_.dot(sums_.col(t).segment(p, q));
      variances_[t] = std::max(0.f, sums_(2 * p + kShadings, t) + explained) /
                      static_cast<float>(tiles_[static_cast<std::size_t>(t)].count);
      if (weights_[t] > 0.f)
      {
        sorted_[kept++] = variances_[t];
      }
    }
    if (pass == kReweightings || kept == 0)
    {
      break;
    }
    std::nth_element(sorted_.data(), sorted_.data() + kept / 2, sorted_.data() + kept);
    const float scale = std::max(sorted_[kept / 2], static_cast<float>(floor_));
    float change = 0.f;
    for (Eigen::Index t = 0; t < tiles; ++t)
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
      break;
    }
  }

  double squares = 0.0;
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    // The first nuisance pattern is the constant c: sum of the residual times c, of which c^2 a pixel.
    const float sum = sums_(2 * p, t) - product_[t * q + p];
    squares += static_cast<double>(weights_[t] * sum * sum / std::max(energy_(t * q + p, p), 1e-30f));
  }
  product_.noalias() = normal_ * unknown_;
  float residual = 0.f, texture = 0.f;
  double counted = 0.0, all = 0.0;
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    const float w = weights_[t];
    auto score = scores_.col(t);
    score.head(p) = sums_.col(t).head(p).cast<double>();
    score.tail<kShadings>() = sums_.col(t).segment<kShadings>(2 * p).cast<double>();
    score -= product_.segment(t * q, q).cast<double>();
    score *= static_cast<double>(w);
    const float count = static_cast<float>(tiles_[static_cast<std::size_t>(t)].count);
    residual += w * variances_[t] * count;
    texture += w * energy_(t * q + q - 1, q - 1);
    counted += static_cast<double>(w * count);
    all += static_cast<double>(count);
  }
  System scatter = scoreScatter();
  // An image that is more like the template than noise allows is the template's own: the truth is not known better.
  const double missing = floor_ - static_cast<double>(residual) / std::max(counted, 1.0);
  scatter += std::max(0.0, missing) * all_squares_;
  // So many tiles that tell as much as these would tell if all told the same; sums of four neighbours are as good as
  // independent ones of 1 / 2.25 of that number; so few give too small a scatter.
  const auto told = information_ * weights_.cast<double>();
  const double independent = told.sum() * told.sum() / std::max(told.square().sum(), 1e-30) / 2.25;
  const double freedom = independent / std::max(1.0, independent - p - 1);
  solution_.motion = unknown_.head(p);
  solution_.covariance = freedom * (inverse * scatter * inverse.transpose()).topLeftCorner(p, p);
  const float strength = (unknown_[q - 1] + contrast_) * std::sqrt(texture);
  residual += static_cast<float>(counted) * static_cast<float>(floor_) * 0.01f;
  solution_.correlation = strength / std::sqrt(strength * strength + residual);
  solution_.share = counted / all;
  const double variance = static_cast<double>(residual) / std::max(counted, 1.0);
  solution_.unevenness = squares / std::max(static_cast<double>(weights_.sum()) * variance, 1e-30);
}
}  // namespace xray_tracking
