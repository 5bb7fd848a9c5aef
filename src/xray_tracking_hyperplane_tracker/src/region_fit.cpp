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
/// A residual's variance in units of the noise's is hardly less: between pixels, bilinear sampling leaves a quarter.
constexpr double kLeastNoise = 0.2;
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
    floor_(kLeastNoise * model.noise * model.noise)
{
  layTiles(region);
  const Eigen::Index n = points_.rows();
  values_.resize(n);
  sampled_.resize(n);
  outside_.resize(n);

  // Derivatives by the motion, on the grid for the filter.
  constexpr int kMargin = 16;
  const cv::Rect seen =
      cv::Rect(region.x - kMargin, region.y - kMargin, region.width + 2 * kMargin, region.height + 2 * kMargin) &
      cv::Rect(cv::Point(), image.size());
  const cv::Mat raw = attenuationImage(image(seen), intensity);
  const cv::Mat smooth = withoutNoise(raw, model.noise);
  cv::Mat gradient_x, gradient_y;
  cv::Sobel(smooth, gradient_x, CV_32F, 1, 0, 1, 0.5);
  cv::Sobel(smooth, gradient_y, CV_32F, 0, 1, 1, 0.5);
  const Eigen::Vector2d centre(region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1));
  const Whitening whitening(grid_, step_, model);
  std::array<Eigen::MatrixXf, 2> instruments;
  instruments.fill(Eigen::MatrixXf(n, parameters));
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
      instruments[WHITE](i, k) = derivative.at<float>(place);
      instruments[OVERLAY](i, k) = instrument.at<float>(place);
    }
  }

  const Eigen::MatrixXd shading = shadingPatterns(points_, region);
  Eigen::MatrixXd patterns(n, kShadings);
  Eigen::VectorXf noise(n);
  // The template's own noise would answer to the derivatives of the same noise, and make all contrasts seem too low
  // (regression dilution): without it.
  patterns.leftCols<kShadings - 1>() = shading;
  for (Eigen::Index i = 0; i < n; ++i)
  {
    values_[i] = smooth.at<float>(on_grid(i) - seen.tl());
    noise[i] = raw.at<float>(on_grid(i) - seen.tl()) - values_[i];
    patterns(i, kShadings - 1) = static_cast<double>(values_[i]);
  }
  const auto clear_padding = [this](auto& columns)
  {
    for (const Tile& tile : tiles_)
    {
      columns.middleRows(tile.begin + tile.count, tile.padded - tile.count).setZero();
    }
  };
  clear_padding(patterns);
  clear_padding(noise);
  const Nuisance found(patterns);
  for (Eigen::MatrixXf& columns : instruments)
  {
    clear_padding(columns);
    found.removeFrom(columns);
  }
  Eigen::MatrixXf nuisance = found.basis();
  contrast_ = nuisance.rightCols<1>().dot(patterns.rightCols<1>().cast<float>());
  if (contrast_ < 0.f)
  {
    contrast_ = -contrast_;
    nuisance.rightCols<1>() *= -1.f;
  }
  store(instruments, nuisance, noise);

  const Eigen::Index tiles = static_cast<Eigen::Index>(tiles_.size());
  sums_.resize(2 * parameters + kShadings + 1, tiles);
  weights_.resize(tiles);
  variances_.resize(tiles);
  sorted_.resize(tiles);
  product_.resize(tiles * unknowns_);
  scores_.resize(unknowns_, tiles);
}

void RegionFit::store(const std::array<Eigen::MatrixXf, 2>& instruments, const Eigen::MatrixXf& nuisance,
                      const Eigen::VectorXf& template_noise)
{
  const Eigen::Index tiles = static_cast<Eigen::Index>(tiles_.size());
  const int p = parameters_;
  const int q = unknowns_;
  columns_.resize(points_.rows() * (2 * p + kShadings));
  for (const Noise noise : { WHITE, OVERLAY })
  {
    normal_[noise].resize(tiles * q, q);
    all_normal_[noise] = Eigen::MatrixXd::Zero(q, q);
    all_squares_[noise] = Eigen::MatrixXd::Zero(q, q);
    noise_scores_[noise].resize(q, tiles);
  }
  tolerance_.resize(tiles);
  float* column = columns_.data();
  for (Eigen::Index t = 0; t < tiles; ++t)
  {
    const Tile& tile = tiles_[static_cast<std::size_t>(t)];
    const auto rows = [&tile](const Eigen::MatrixXf& all) { return all.middleRows(tile.begin, tile.padded); };
    Eigen::Map<Eigen::MatrixXf> stored(column, tile.padded, 2 * p + kShadings);
    stored << rows(instruments[WHITE]), rows(instruments[OVERLAY]), rows(nuisance);
    column += stored.size();
    Eigen::MatrixXf right(tile.padded, q), left(tile.padded, q);
    right << rows(instruments[WHITE]), rows(nuisance);
    for (const Noise noise : { WHITE, OVERLAY })
    {
      left << rows(instruments[noise]), rows(nuisance);
      normal_[noise].middleRows(t * q, q) = left.transpose() * right;
      all_normal_[noise] += normal_[noise].middleRows(t * q, q).cast<double>();
      all_squares_[noise] += (left.transpose() * left).cast<double>();
      noise_scores_[noise].col(t) = (left.transpose() * template_noise.segment(tile.begin, tile.padded)).cast<double>();
    }
    tolerance_[t] = kMotionError * kMotionError * right.leftCols(2).squaredNorm() / static_cast<float>(tile.count);
  }

  for (const Noise noise : { WHITE, OVERLAY })
  {
    information_[noise].resize(tiles);
    for (Eigen::Index t = 0; t < tiles; ++t)
    {
      const Eigen::MatrixXd part = normal_[noise].middleRows(t * q, q).cast<double>();
      information_[noise][t] = (part.diagonal().array() / all_normal_[noise].diagonal().array()).head(p).sum();
    }
  }
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

const RegionFit::Motions& RegionFit::solve(const cv::Mat& image, const IntensityModel& intensity, const PixelMap& map,
                                           double& inside)
{
  const int outside = samplePoints(image, intensity, points_, box_, map, sampled_, outside_);
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
        unknown.dot(product_.segment(t * q, q)) - 2.f * unknown.dot(UnknownsOfTiles(right(WHITE, t).cast<float>()));
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
  // What four of them tell of the motion has gone into it, and is not left in their residuals. Their sums are as good
  // as independent ones of 1 / 2.25 of the tiles' number; of so few, the inverse of the displacement's covariance is
  // too large.
  const double independent = tiles / 2.25;
  const double freedom = tiles / std::max(1.0, tiles - 4.0) * independent / std::max(1.0, independent - 3.0);
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
