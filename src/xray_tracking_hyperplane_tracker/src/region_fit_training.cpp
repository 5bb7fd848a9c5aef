// What a RegionFit learns from a template.

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "predictor.h"
#include "region_fit.h"
#include "spectral_filter.h"
#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr int kLane = 8;          ///< floats in a vector
constexpr double kTiles = 100.0;  ///< about; enough for their scatter to be an estimate
/// Error of the motion [px] whose residual does not make an outlier.
constexpr float kMotionError = 0.15f;
/// A residual's variance is hardly less: what the spline's kernel leaves of the noise between four pixels, 0.21 of
/// white noise.
double leastNoise(const NoiseSpectrum& noise)
{
  float weights[4];
  splineWeights(0.5f, weights);
  const auto gain = [&weights](double f)
  { return 2.0 * (weights[0] * std::cos(3.0 * M_PI * f) + weights[1] * std::cos(M_PI * f)); };
  return noise.variance([&gain](double u, double v) { return gain(u) * gain(v); });
}

/// Mean distance along an axis of pixels whose noise is alike, by itself and the spline's kernel [px]; 0.56 for white
/// noise.
double noiseReach(const NoiseSpectrum& noise)
{
  constexpr int kLags = 24;
  constexpr int kSteps = 128;
  double sum = 0.0, moment = 0.0;
  for (int lag = 0; lag < kLags; ++lag)
  {
    double covariance = 0.0;
    for (int i = 0; i < kSteps; ++i)
    {
      const double f = 0.5 * (i + 0.5) / kSteps;
      const double gain = (2.0 + std::cos(2.0 * M_PI * f)) / 3.0;
      covariance += noise.power(f) * gain * gain * std::cos(2.0 * M_PI * f * lag);
    }
    sum += (lag > 0 ? 2.0 : 1.0) * covariance;
    moment += 2.0 * lag * std::abs(covariance);
  }
  return moment / sum;
}

/// Share of the noise's scatter along an axis that pairs of neighbouring tiles see: of pairs of pixels across their
/// border, every second one. Where noise reaches farther than tiles this says nothing; then there are still some.
double noiseSeen(double reach, double tile)
{
  constexpr double kLeast = 0.2;
  return std::min(1.0, std::max(kLeast, 1.0 - 0.5 * reach / tile));
}

/// Of an image by x and y.
class Gradients
{
public:
  explicit Gradients(const cv::Mat& image)
  {
    cv::Sobel(image, x_, CV_32F, 1, 0, 1, 0.5);
    cv::Sobel(image, y_, CV_32F, 0, 1, 1, 0.5);
  }
  float along(const Eigen::Vector2d& motion, const cv::Point& place) const
  {
    return static_cast<float>(motion.x()) * x_.at<float>(place) + static_cast<float>(motion.y()) * y_.at<float>(place);
  }

private:
  cv::Mat x_, y_;
};

/// What solve() finds at the pixels of an image with these values: it samples counts before they become attenuation.
cv::Mat asSampled(const cv::Mat& values, const IntensityModel& intensity)
{
  if (intensity.kind != IntensityModel::Kind::COUNTS)
  {
    return splineFiltered(values);
  }
  cv::Mat counts;
  cv::exp(-values, counts);
  counts = splineFiltered(counts);
  cv::log(counts, counts);
  return -counts;
}
}  // namespace

void RegionFit::layTiles(const cv::Rect& region, double noise_reach)
{
  const double side = std::max(4.0, std::sqrt(grid_.area() / kTiles));
  const int columns = std::max(1, static_cast<int>(std::lround(grid_.width / side)));
  const int rows = std::max(1, static_cast<int>(std::lround(grid_.height / side)));
  tile_columns_ = columns;
  noise_seen_ = noiseSeen(noise_reach, static_cast<double>(region.width) / columns) *
                noiseSeen(noise_reach, static_cast<double>(region.height) / rows);
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
    floor_(leastNoise(model.noise))
{
  layTiles(region, noiseReach(model.noise));
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
  const cv::Mat without_noise = withoutNoise(raw, model.noise);
  const cv::Mat smooth = asSampled(without_noise, intensity);
  const cv::Mat noise_image = splineFiltered(raw - without_noise);
  // What the motion makes of f, and the instruments, which are not blurred: the sums blur the noise once already.
  const Eigen::Vector2d centre(region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1));
  const Whitening whitening(grid_, step_, model);
  const Gradients blurred(smooth), sharp(without_noise);
  Eigen::MatrixXf slopes(n, parameters);
  std::array<Eigen::MatrixXf, 2> instruments;
  instruments.fill(Eigen::MatrixXf(n, parameters));
  const auto on_grid = [&](Eigen::Index i)
  { return cv::Point(static_cast<int>(points_(i, 0)), static_cast<int>(points_(i, 1))); };
  for (int k = 0; k < parameters; ++k)
  {
    cv::Mat slope(grid_, CV_32F), instrument(grid_, CV_32F);
    for (int y = 0; y < grid_.height; ++y)
    {
      for (int x = 0; x < grid_.width; ++x)
      {
        const cv::Point place(region.x + x * step_, region.y + y * step_);
        const Eigen::Vector2d motion =
            k < 2 ? Eigen::Vector2d::Unit(k)
                  : (generator(k) * (Eigen::Vector2d(place.x, place.y) - centre) / radius).eval();
        slope.at<float>(y, x) = blurred.along(motion, place - seen.tl());
        instrument.at<float>(y, x) = sharp.along(motion, place - seen.tl());
      }
    }
    const cv::Mat whitened = whitening(instrument);
    for (Eigen::Index i = 0; i < n; ++i)
    {
      const cv::Point place = (on_grid(i) - region.tl()) / step_;
      slopes(i, k) = slope.at<float>(place);
      instruments[WHITE](i, k) = instrument.at<float>(place);
      instruments[OVERLAY](i, k) = whitened.at<float>(place);
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
    noise[i] = noise_image.at<float>(on_grid(i) - seen.tl());
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
  for (Eigen::MatrixXf* columns : { &slopes, &instruments[WHITE], &instruments[OVERLAY] })
  {
    clear_padding(*columns);
    found.removeFrom(*columns);
  }
  Eigen::MatrixXf nuisance = found.basis();
  contrast_ = nuisance.rightCols<1>().dot(patterns.rightCols<1>().cast<float>());
  if (contrast_ < 0.f)
  {
    contrast_ = -contrast_;
    nuisance.rightCols<1>() *= -1.f;
  }
  store(slopes, instruments, nuisance, noise);

  const Eigen::Index tiles = static_cast<Eigen::Index>(tiles_.size());
  sums_.resize(2 * parameters + kShadings + 1, tiles);
  weights_.resize(tiles);
  variances_.resize(tiles);
  sorted_.resize(tiles);
  product_.resize(tiles * unknowns_);
  scores_.resize(unknowns_, tiles);
}

void RegionFit::store(const Eigen::MatrixXf& slopes, const std::array<Eigen::MatrixXf, 2>& instruments,
                      const Eigen::MatrixXf& nuisance, const Eigen::VectorXf& template_noise)
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
    right << rows(slopes), rows(nuisance);
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
}  // namespace xray_tracking
