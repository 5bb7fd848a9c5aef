// How far off predictions of the target's place are, by method, motion and horizon: the comparison that the predictor
// of pose_predictor.h was chosen by. Every method sees the same noisy exposures at 30 Hz.

#include <array>
#include <chrono>
#include <cstdio>
#include <functional>
#include <memory>
#include <random>
#include <vector>

#include <Eigen/Dense>
#include <boost/circular_buffer.hpp>

#include "xray_tracking_motion_estimation/axis_predictor.h"
#include "xray_tracking_motion_estimation/motion_traces.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
namespace
{
constexpr std::array<double, 9> kHorizons = { 0.0, 1.0 / 30, 2.0 / 30, 0.115, 0.2, 0.3, 0.4, 0.5, 0.65 };
constexpr double kDuration = 120.0;
constexpr double kWarmUp = 10.0;
constexpr int kSeeds = 10;

class Method
{
public:
  virtual ~Method() = default;
  virtual void add(double value, double variance) = 0;
  virtual double predict(std::size_t horizon) const = 0;
};

class Hold : public Method
{
public:
  void add(double value, double) override { value_ = value; }
  double predict(std::size_t) const override { return value_; }

private:
  double value_ = 0.0;
};

/// One of the models by itself.
template <typename Model>
class Single : public Method
{
public:
  explicit Single(double intensity) : intensity_(intensity) {}
  void add(double value, double variance) override
  {
    started_ ? model_.add(kExposureInterval, value, variance) : model_.reset(intensity_, value, variance);
    started_ = true;
  }
  double predict(std::size_t horizon) const override { return model_.predict(kHorizons[horizon]).value; }

private:
  double intensity_;
  bool started_ = false;
  Model model_;
};

class Mixture : public Method
{
public:
  explicit Mixture(double latency) : predictor_(latency) {}
  void add(double value, double variance) override
  {
    started_ ? predictor_.add(kExposureInterval, value, variance) : predictor_.reset(value, variance);
    started_ = true;
  }
  double predict(std::size_t horizon) const override { return predictor_.predict(kHorizons[horizon]).value; }

private:
  AxisPredictor predictor_;
  bool started_ = false;
};

/// A linear combination of past exposures, about their mean, learnt while it runs: one for each horizon, which falls
/// between two exposures' is the next exposure's.
class LinearFilter : public Method
{
public:
  LinearFilter(int taps, int spacing) : taps_(taps), spacing_(spacing), values_(taps * spacing + kMaxLag)
  {
    for (Eigen::VectorXd& weights : weights_)
    {
      weights = Eigen::VectorXd::Unit(taps, 0);
    }
  }
  void add(double value, double) override
  {
    values_.push_front(value);
    for (std::size_t i = 0; values_.full() && i < kHorizons.size(); ++i)
    {
      const auto [mean, window] = windowBefore(lag(i));
      learn(i, window, value - mean - weights_[i].dot(window));
    }
  }
  double predict(std::size_t horizon) const override
  {
    if (!values_.full())
    {
      return values_.front();
    }
    const auto [mean, window] = windowBefore(0);
    return mean + weights_[horizon].dot(window);
  }

protected:
  virtual void learn(std::size_t horizon, const Eigen::VectorXd& window, double error) = 0;
  std::array<Eigen::VectorXd, kHorizons.size()> weights_;

private:
  static constexpr int kMaxLag = 20;
  static int lag(std::size_t horizon) { return static_cast<int>(std::lround(kHorizons[horizon] / kExposureInterval)); }
  std::pair<double, Eigen::VectorXd> windowBefore(int lag) const
  {
    Eigen::VectorXd window(taps_);
    for (int i = 0; i < taps_; ++i)
    {
      window[i] = values_[lag + i * spacing_];
    }
    const double mean = window.mean();
    return { mean, (window.array() - mean).matrix() };
  }

  int taps_;
  int spacing_;
  boost::circular_buffer<double> values_;
};

class NormalisedLms : public LinearFilter
{
public:
  NormalisedLms(int taps, int spacing, double gain) : LinearFilter(taps, spacing), gain_(gain) {}

protected:
  void learn(std::size_t horizon, const Eigen::VectorXd& window, double error) override
  {
    weights_[horizon] += gain_ * error / (window.squaredNorm() + 1.0) * window;
  }

private:
  double gain_;
};

class RecursiveLeastSquares : public LinearFilter
{
public:
  RecursiveLeastSquares(int taps, int spacing, double memory) : LinearFilter(taps, spacing), memory_(memory)
  {
    inverse_.fill(0.1 * Eigen::MatrixXd::Identity(taps, taps));
  }

protected:
  void learn(std::size_t horizon, const Eigen::VectorXd& window, double error) override
  {
    Eigen::MatrixXd& inverse = inverse_[horizon];
    const Eigen::VectorXd product = inverse * window;
    const Eigen::VectorXd gain = product / (memory_ + window.dot(product));
    weights_[horizon] += error * gain;
    inverse = (inverse - gain * product.transpose()) / memory_;
    inverse *= std::min(1.0, 1e3 / inverse.trace());
  }

private:
  double memory_;
  std::array<Eigen::MatrixXd, kHorizons.size()> inverse_;
};

struct NamedMethod
{
  const char* name;
  std::function<std::unique_ptr<Method>()> make;
};

template <typename T, typename... Arguments>
NamedMethod named(const char* name, Arguments... arguments)
{
  return { name, [=] { return std::make_unique<T>(arguments...); } };
}

std::vector<NamedMethod> allMethods()
{
  // Of each kind the settings that did best in a coarse search on breathing at 0.115 s.
  return { named<Hold>("hold"),
           named<Single<PolynomialMotion<2>>>("constant velocity", 100.0),
           named<Single<PolynomialMotion<3>>>("constant acceleration", 1000.0),
           named<NormalisedLms>("normalised LMS", 20, 5, 0.05),
           named<RecursiveLeastSquares>("recursive least squares", 15, 4, 0.9995),
           named<Single<HarmonicMotion>>("harmonic", 0.1),
           named<Mixture>("mixture for 115 ms", 0.115),
           named<Mixture>("mixture for 650 ms", 0.65) };
}

using Errors = std::array<double, kHorizons.size()>;

/// RMS distance of the predicted target's centre from the true one.
Errors judge(const NamedMethod& method, const NamedMotion& motion)
{
  Errors sum{};
  double count = 0.0;
  for (unsigned seed = 1; seed <= kSeeds; ++seed)
  {
    const MotionTrace trace = motion.make(seed, kDuration);
    std::mt19937 random(1000 + seed);
    std::normal_distribution<double> normal;
    const double sigma = std::uniform_real_distribution<double>(0.05, 0.1)(random);
    std::array<std::unique_ptr<Method>, 3> axes{ method.make(), method.make(), method.make() };
    for (double time = 0.0; time < kDuration - 1.0; time += kExposureInterval)
    {
      const Vector6d now = trace(time);
      for (int axis = 0; axis < 3; ++axis)
      {
        axes[axis]->add(now[axis] + sigma * normal(random), sigma * sigma);
      }
      if (time < kWarmUp)
      {
        continue;
      }
      ++count;
      for (std::size_t i = 0; i < kHorizons.size(); ++i)
      {
        const Vector6d then = trace(time + kHorizons[i]);
        for (int axis = 0; axis < 3; ++axis)
        {
          const double error = axes[axis]->predict(i) - then[axis];
          sum[i] += error * error;
        }
      }
    }
  }
  for (double& value : sum)
  {
    value = std::sqrt(value / count);
  }
  return sum;
}

/// Mean normalised squared error of the predicted pose (6 if the covariance is right), and the time it takes.
void judgePoses(const NamedMotion& motion)
{
  Errors sum{};
  double count = 0.0;
  std::chrono::duration<double> spent{ 0.0 };
  for (unsigned seed = 1; seed <= kSeeds; ++seed)
  {
    const MotionTrace trace = motion.make(seed, kDuration);
    std::mt19937 random(1000 + seed);
    std::normal_distribution<double> normal;
    const Vector6d sigma = (Vector6d() << 0.08, 0.06, 0.06, 0.002, 0.002, 0.002).finished();
    PosePredictor predictor({}, traceTarget());
    for (double time = 0.0; time < kDuration - 1.0; time += kExposureInterval)
    {
      Vector6d noise;
      for (double& value : noise)
      {
        value = normal(random);
      }
      const RigidTransform pose = tracePose(trace(time) + sigma.cwiseProduct(noise));
      const Matrix6d covariance = covarianceAtOrigin(pose, sigma.cwiseAbs2().asDiagonal());
      const std::int64_t stamp = std::llround(1e9 * time);
      const auto start = std::chrono::steady_clock::now();
      predictor.add(stamp, pose, covariance);
      predictor.predict(stamp + 115000000);
      spent += std::chrono::steady_clock::now() - start;
      count += time < kWarmUp ? 0.0 : 1.0;
      for (std::size_t i = 0; time >= kWarmUp && i < kHorizons.size(); ++i)
      {
        const auto prediction = predictor.predict(stamp + std::llround(1e9 * kHorizons[i]));
        const RigidTransform then = tracePose(trace(time + kHorizons[i]));
        Vector6d error;
        error << prediction->room_from_patient.translation() - then.translation(),
            vectorFromRotation(prediction->room_from_patient.linear() * then.linear().transpose());
        sum[i] += error.dot(prediction->covariance.ldlt().solve(error));
      }
    }
  }
  std::printf("| %-23s |", motion.name.c_str());
  for (const double value : sum)
  {
    std::printf(" %6.2f |", value / count);
  }
  std::printf(" %5.1f us an exposure\n", 1e6 * spent.count() / (kSeeds * (kDuration - 1.0) / kExposureInterval));
}

void printHead(const char* title)
{
  std::printf("\n| %-23s |", title);
  for (const double horizon : kHorizons)
  {
    std::printf(" %3.0f ms |", 1e3 * horizon);
  }
  std::printf("\n|---|");
  for (std::size_t i = 0; i < kHorizons.size(); ++i)
  {
    std::printf("---|");
  }
  std::printf("\n");
}

int benchmarkPrediction(const boost::program_options::variables_map&)
{
  std::printf("RMS error of the predicted place [mm]\n");
  for (const NamedMotion& motion : allMotions())
  {
    printHead(motion.name.c_str());
    for (const NamedMethod& method : allMethods())
    {
      std::printf("| %-23s |", method.name);
      for (const double error : judge(method, motion))
      {
        std::printf(" %6.3f |", error);
      }
      std::printf("\n");
      std::fflush(stdout);
    }
  }
  std::printf("\nMean normalised squared error of the predicted pose, 6 expected\n");
  printHead("mixture");
  for (const NamedMotion& motion : allMotions())
  {
    judgePoses(motion);
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.description =
      "How far off predictions of the target's place are, by method, motion and horizon, from the same noisy "
      "exposures\n"
      "at 30 Hz: the comparison that the predictor was chosen by. Tables in Markdown; takes a minute.";
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkPrediction);
}
