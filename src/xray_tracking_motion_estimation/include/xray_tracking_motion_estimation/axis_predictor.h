#pragma once

#include <array>
#include <cstddef>

#include <Eigen/Core>
#include <boost/circular_buffer.hpp>

namespace xray_tracking
{
/// A predicted number and its variance.
struct Forecast
{
  double value;
  double variance;
};

/// Position whose (Order - 1)th derivative is a random walk: Order 1 is a random walk, 2 constant velocity with random
/// acceleration, 3 constant acceleration with random jerk. A Kalman filter of one measured position.
template <int Order>
class PolynomialMotion
{
public:
  /// @param intensity of the white noise that drives the random walk [mm^2 / s^(2 Order - 1)]
  void reset(double intensity, double value, double variance);
  void add(double elapsed, double value, double variance);
  Forecast predict(double horizon) const;
  void shift(double by) { state_[0] += by; }

private:
  using State = Eigen::Matrix<double, Order, 1>;
  using Covariance = Eigen::Matrix<double, Order, Order>;
  void propagate(double elapsed);

  double intensity_ = 0.0;
  State state_ = State::Zero();
  Covariance covariance_ = Covariance::Zero();
};

/// Breathing: a slowly wandering offset and a fundamental with its first overtone, whose amplitudes, phases and common
/// frequency wander, too. An extended Kalman filter.
class HarmonicMotion
{
public:
  /// @param amplitude_intensity of the white noise that drives the amplitudes [mm^2 / s]
  void reset(double amplitude_intensity, double value, double variance);
  void add(double elapsed, double value, double variance);
  Forecast predict(double horizon) const;
  void shift(double by) { state_[0] += by; }

private:
  static constexpr int kStates = 6;  // offset, two for each of two harmonics, angular frequency
  using State = Eigen::Matrix<double, kStates, 1>;
  using Covariance = Eigen::Matrix<double, kStates, kStates>;
  void propagate(double elapsed);

  double amplitude_intensity_ = 0.0;
  State state_ = State::Zero();
  Covariance covariance_ = Covariance::Zero();
};

/// Prediction of one coordinate of a moving target: a mixture of motion models, from a standstill to breathing,
/// weighted by how well each has lately predicted a given time ahead. Which model is right changes (a cough, a pause
/// between breaths), and a model that follows best from exposure to exposure is not the one that sees furthest; so the
/// weights come from the prediction that is asked for. What the mixture's variance grows by with the horizon is scaled
/// by how large its errors have been.
///
/// Lengths are in mm: models and their noise are those of a body's motion. Constant time and memory, no allocation.
class AxisPredictor
{
public:
  /// @param latency time ahead that predictions are judged by [s], > 0
  explicit AxisPredictor(double latency) : latency_(latency) {}

  /// Starts over at a measured value. @param variance of its error [mm^2], > 0
  void reset(double value, double variance);

  /// @param elapsed since the last value [s], > 0
  /// @param variance of the value's error [mm^2], > 0. A part of it may be the same in all recent values; only what
  ///   changes from value to value is filtered as noise, see noiseVariance().
  void add(double elapsed, double value, double variance);

  /// @param horizon since the last value [s], >= 0
  Forecast predict(double horizon) const;

  /// Moves past and future by a constant, as a correction of the zero point does.
  void shift(double by);

  /// Variance of what is new in the error of every value [mm^2]: estimated from how far values lie off the line between
  /// their neighbours, and never more than the variance that came with the values.
  double noiseVariance() const { return noise_variance_; }

private:
  static constexpr std::size_t kModels = 11;
  static constexpr std::size_t kSnapshots = 8;
  using Forecasts = std::array<Forecast, kModels>;

  struct Models
  {
    void reset(double value, double variance);
    void add(double elapsed, double value, double variance);
    Forecasts predict(double horizon) const;
    void shift(double by);
    template <typename Self, typename Function>
    static void forEach(Self& self, Function function);

    double time = 0.0;  // [s] since reset
    std::array<PolynomialMotion<1>, 3> standing;
    std::array<PolynomialMotion<2>, 3> drifting;
    std::array<PolynomialMotion<3>, 3> accelerating;
    std::array<HarmonicMotion, 2> breathing;
  };

  void estimateNoise(double elapsed, double value, double variance);
  void judge(double elapsed, double value);
  void remember();
  Forecast mix(const Forecasts& forecasts) const;
  Forecast scaled(Forecast mixture, const Models& models) const;

  double latency_;
  Models models_;
  std::array<double, kModels> log_weights_{};
  double scale_ = 1.0;  ///< of what the mixture's variance grows by with the horizon

  // Models as they were, the oldest first: what they would have predicted is compared with what came.
  boost::circular_buffer<Models> snapshots_{ kSnapshots };

  double noise_variance_ = 0.0;
  double noise_estimate_ = 0.0;
  std::array<double, 2> previous_values_{};
  double previous_elapsed_ = 0.0;  ///< between these two, 0 if there is but one
};
}  // namespace xray_tracking
