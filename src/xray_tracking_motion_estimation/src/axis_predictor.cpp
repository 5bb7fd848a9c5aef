#include "xray_tracking_motion_estimation/axis_predictor.h"

#include <algorithm>
#include <cmath>

namespace xray_tracking
{
namespace
{
// Standard deviations before anything was measured: of a living body's velocity [mm/s], acceleration [mm/s^2] and
// amplitude [mm].
constexpr double kVelocitySigma = 20.0;
constexpr double kAccelerationSigma = 20.0;
constexpr double kOffsetSigma = 2.0;
constexpr double kAmplitudeSigma = 3.0;

// Breathing takes 1.6 to 12.6 s, mostly 3 to 6.
constexpr double kFrequency = 2.0 * M_PI / 4.0;  // rad/s
constexpr double kFrequencyVariance = 0.05;
constexpr double kMinFrequency = 0.5;
constexpr double kMaxFrequency = 4.0;
constexpr double kFrequencyIntensity = 0.01;  // rad^2/s^3
constexpr double kOffsetIntensity = 0.05;     // mm^2/s

// Random walks that the models' highest derivatives make, from hardly any to the liveliest that breathing needs.
constexpr std::array<double, 3> kStanding = { 1e-3, 1e-1, 1e1 };
constexpr std::array<double, 3> kDrifting = { 1e-2, 1.0, 1e2 };
constexpr std::array<double, 3> kAccelerating = { 1e1, 1e3, 1e4 };
constexpr std::array<double, 2> kBreathing = { 0.1, 0.5 };

constexpr double kMemory = 1.6;  // s, what a model's past errors count for less and less
// Errors of predictions that overlap are no independent evidence: a latency is some three exposures.
constexpr double kEvidence = 0.3;
constexpr double kScaleGain = 0.02;
constexpr double kMinScale = 0.2;
constexpr double kMaxScale = 25.0;
constexpr double kLargestSurprise = 9.0;

constexpr double kNoiseMemory = 2.0;      // s
constexpr double kNoiseMaxElapsed = 0.1;  // s, over which motion is as good as straight
constexpr double kNoiseFloor = 1e-4;      // mm^2
}  // namespace

template <int Order>
void PolynomialMotion<Order>::reset(double intensity, double value, double variance)
{
  constexpr std::array<double, 3> kSigma = { 0.0, kVelocitySigma, kAccelerationSigma };
  intensity_ = intensity;
  state_.setZero();
  state_[0] = value;
  covariance_.setZero();
  covariance_(0, 0) = variance;
  for (int i = 1; i < Order; ++i)
  {
    covariance_(i, i) = kSigma[i] * kSigma[i];
  }
}

template <int Order>
void PolynomialMotion<Order>::propagate(double elapsed)
{
  constexpr std::array<double, 3> kFactorial = { 1.0, 1.0, 2.0 };
  std::array<double, 2 * Order> power;
  power[0] = 1.0;
  for (int i = 1; i < 2 * Order; ++i)
  {
    power[i] = power[i - 1] * elapsed;
  }
  Covariance transition = Covariance::Identity();
  Covariance noise;
  for (int i = 0; i < Order; ++i)
  {
    for (int j = i + 1; j < Order; ++j)
    {
      transition(i, j) = power[j - i] / kFactorial[j - i];
    }
    for (int j = 0; j < Order; ++j)
    {
      const int a = Order - 1 - i;
      const int b = Order - 1 - j;
      noise(i, j) = intensity_ * power[a + b + 1] / (kFactorial[a] * kFactorial[b] * (a + b + 1));
    }
  }
  state_ = transition * state_;
  covariance_ = transition * covariance_ * transition.transpose() + noise;
}

template <int Order>
void PolynomialMotion<Order>::add(double elapsed, double value, double variance)
{
  propagate(elapsed);
  const State gain = covariance_.col(0) / (covariance_(0, 0) + variance);
  state_ += gain * (value - state_[0]);
  const State row = covariance_.col(0);
  covariance_.noalias() -= gain * row.transpose();
  covariance_ = (0.5 * (covariance_ + covariance_.transpose())).eval();
}

template <int Order>
Forecast PolynomialMotion<Order>::predict(double horizon) const
{
  PolynomialMotion future = *this;
  future.propagate(horizon);
  return { future.state_[0], future.covariance_(0, 0) };
}

template class PolynomialMotion<1>;
template class PolynomialMotion<2>;
template class PolynomialMotion<3>;

void HarmonicMotion::reset(double amplitude_intensity, double value, double variance)
{
  amplitude_intensity_ = amplitude_intensity;
  state_.setZero();
  state_[0] = value;
  state_[kStates - 1] = kFrequency;
  State variances;
  variances.fill(kAmplitudeSigma * kAmplitudeSigma);
  variances[0] = kOffsetSigma * kOffsetSigma;
  variances[kStates - 1] = kFrequencyVariance;
  covariance_ = variances.asDiagonal();
  add(0.0, value, variance);
}

void HarmonicMotion::propagate(double elapsed)
{
  const double frequency = state_[kStates - 1];
  Covariance transition = Covariance::Identity();
  State noise = State::Zero();
  noise[0] = kOffsetIntensity * elapsed;
  noise[kStates - 1] = kFrequencyIntensity * elapsed;
  for (int harmonic = 1; harmonic <= 2; ++harmonic)
  {
    const int i = 2 * harmonic - 1;
    const double cosine = std::cos(harmonic * frequency * elapsed);
    const double sine = std::sin(harmonic * frequency * elapsed);
    transition.block<2, 2>(i, i) << cosine, sine, -sine, cosine;
    state_.segment<2>(i) = (transition.block<2, 2>(i, i) * state_.segment<2>(i)).eval();
    transition(i, kStates - 1) = harmonic * elapsed * state_[i + 1];
    transition(i + 1, kStates - 1) = -harmonic * elapsed * state_[i];
    noise.segment<2>(i).fill(amplitude_intensity_ * elapsed / harmonic);
  }
  covariance_ = transition * covariance_ * transition.transpose();
  covariance_.diagonal() += noise;
}

void HarmonicMotion::add(double elapsed, double value, double variance)
{
  propagate(elapsed);
  // What is measured is the sum of the offset and each harmonic's first component.
  const State column = covariance_.col(0) + covariance_.col(1) + covariance_.col(3);
  const State gain = column / (column[0] + column[1] + column[3] + variance);
  state_ += gain * (value - (state_[0] + state_[1] + state_[3]));
  covariance_.noalias() -= gain * column.transpose();
  covariance_ = (0.5 * (covariance_ + covariance_.transpose())).eval();
  state_[kStates - 1] = std::clamp(state_[kStates - 1], kMinFrequency, kMaxFrequency);
}

Forecast HarmonicMotion::predict(double horizon) const
{
  HarmonicMotion future = *this;
  future.propagate(horizon);
  const State column = future.covariance_.col(0) + future.covariance_.col(1) + future.covariance_.col(3);
  return { future.state_[0] + future.state_[1] + future.state_[3], column[0] + column[1] + column[3] };
}

template <typename Self, typename Function>
void AxisPredictor::Models::forEach(Self& self, Function function)
{
  std::for_each(self.standing.begin(), self.standing.end(), function);
  std::for_each(self.drifting.begin(), self.drifting.end(), function);
  std::for_each(self.accelerating.begin(), self.accelerating.end(), function);
  std::for_each(self.breathing.begin(), self.breathing.end(), function);
}

void AxisPredictor::Models::reset(double value, double variance)
{
  time = 0.0;
  for (std::size_t i = 0; i < standing.size(); ++i)
  {
    standing[i].reset(kStanding[i], value, variance);
    drifting[i].reset(kDrifting[i], value, variance);
    accelerating[i].reset(kAccelerating[i], value, variance);
  }
  for (std::size_t i = 0; i < breathing.size(); ++i)
  {
    breathing[i].reset(kBreathing[i], value, variance);
  }
}

void AxisPredictor::Models::add(double elapsed, double value, double variance)
{
  time += elapsed;
  forEach(*this, [&](auto& model) { model.add(elapsed, value, variance); });
}

AxisPredictor::Forecasts AxisPredictor::Models::predict(double horizon) const
{
  Forecasts forecasts;
  auto next = forecasts.begin();
  forEach(*this, [&](const auto& model) { *next++ = model.predict(horizon); });
  return forecasts;
}

void AxisPredictor::Models::shift(double by)
{
  forEach(*this, [&](auto& model) { model.shift(by); });
}

void AxisPredictor::reset(double value, double variance)
{
  models_.reset(value, variance);
  log_weights_.fill(0.0);
  scale_ = 1.0;
  snapshots_.clear();
  noise_variance_ = variance;
  noise_estimate_ = variance;
  previous_values_ = { value, value };
  previous_elapsed_ = 0.0;
  remember();
}

void AxisPredictor::add(double elapsed, double value, double variance)
{
  estimateNoise(elapsed, value, variance);
  judge(elapsed, value);
  models_.add(elapsed, value, noise_variance_);
  remember();
}

void AxisPredictor::estimateNoise(double elapsed, double value, double variance)
{
  if (previous_elapsed_ > 0.0 && previous_elapsed_ < kNoiseMaxElapsed && elapsed < kNoiseMaxElapsed)
  {
    const double later = previous_elapsed_ / (previous_elapsed_ + elapsed);
    const double earlier = 1.0 - later;
    const double off = previous_values_[1] - earlier * previous_values_[0] - later * value;
    const double sample = off * off / (1.0 + earlier * earlier + later * later);
    noise_estimate_ += (1.0 - std::exp(-elapsed / kNoiseMemory)) * (sample - noise_estimate_);
  }
  noise_variance_ = std::min(variance, std::max(noise_estimate_, kNoiseFloor));
  previous_values_ = { previous_values_[1], value };
  previous_elapsed_ = elapsed;
}

void AxisPredictor::judge(double elapsed, double value)
{
  const double now = models_.time + elapsed;
  // The latest of the old models that had to see at least the latency ahead.
  const auto old = std::find_if(snapshots_.rbegin(), snapshots_.rend(),
                                [&](const Models& models) { return models.time <= now - latency_; });
  if (old == snapshots_.rend())
  {
    return;
  }
  const Models& models = *old;
  const Forecasts forecasts = models.predict(now - models.time);
  const Forecast mixture = scaled(mix(forecasts), models);
  const double surprise = (value - mixture.value) * (value - mixture.value) / (mixture.variance + noise_variance_);
  scale_ *= std::exp(kScaleGain * (std::min(surprise, kLargestSurprise) - 1.0));
  scale_ = std::clamp(scale_, kMinScale, kMaxScale);

  const double forget = std::exp(-elapsed / kMemory);
  for (std::size_t i = 0; i < kModels; ++i)
  {
    const double variance = forecasts[i].variance + noise_variance_;
    const double error = value - forecasts[i].value;
    log_weights_[i] = forget * log_weights_[i] - 0.5 * kEvidence * (std::log(variance) + error * error / variance);
  }
}

void AxisPredictor::remember()
{
  // So far apart that the snapshots span the latency at any exposure rate.
  if (snapshots_.empty() || models_.time - snapshots_.back().time >= latency_ / (kSnapshots - 2))
  {
    snapshots_.push_back(models_);
  }
}

Forecast AxisPredictor::mix(const Forecasts& forecasts) const
{
  const double largest = *std::max_element(log_weights_.begin(), log_weights_.end());
  double total = 0.0;
  std::array<double, kModels> weights;
  Forecast mixture{ 0.0, 0.0 };
  for (std::size_t i = 0; i < kModels; ++i)
  {
    weights[i] = std::exp(log_weights_[i] - largest);
    total += weights[i];
    mixture.value += weights[i] * forecasts[i].value;
  }
  mixture.value /= total;
  for (std::size_t i = 0; i < kModels; ++i)
  {
    const double apart = forecasts[i].value - mixture.value;
    mixture.variance += weights[i] / total * (forecasts[i].variance + apart * apart);
  }
  return mixture;
}

Forecast AxisPredictor::predict(double horizon) const
{
  return scaled(mix(models_.predict(horizon)), models_);
}

Forecast AxisPredictor::scaled(Forecast mixture, const Models& models) const
{
  const double now = mix(models.predict(0.0)).variance;
  mixture.variance = now + scale_ * std::max(mixture.variance - now, 0.0);
  return mixture;
}

void AxisPredictor::shift(double by)
{
  models_.shift(by);
  for (Models& models : snapshots_)
  {
    models.shift(by);
  }
  for (double& value : previous_values_)
  {
    value += by;
  }
}
}  // namespace xray_tracking
