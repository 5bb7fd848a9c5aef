#include "xray_tracking_motion_estimation/pose_predictor.h"

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>
#include <Eigen/Dense>
#include <boost/math/distributions/chi_squared.hpp>

#include "heap_watch.h"
#include "xray_tracking_motion_estimation/motion_traces.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kLatency = 115 * kMillisecond;

Vector6d sigmas(double translation, double rotation)
{
  Vector6d sigma;
  sigma << Eigen::Vector3d::Constant(translation), Eigen::Vector3d::Constant(rotation);
  return sigma;
}

/// A pose as the tracker would give it, with noise of the given deviations at the target.
struct NoisyTracker
{
  Vector6d sigma;
  std::mt19937 random;

  std::pair<RigidTransform, Matrix6d> measure(const Vector6d& motion)
  {
    std::normal_distribution<double> normal;
    Vector6d measured = motion;
    for (int i = 0; i < 6; ++i)
    {
      measured[i] += sigma[i] * normal(random);
    }
    const RigidTransform pose = tracePose(measured);
    return { pose, covarianceAtOrigin(pose, sigma.cwiseAbs2().asDiagonal()) };
  }
};

Vector6d poseError(const RigidTransform& pose, const RigidTransform& truth)
{
  Vector6d error;
  error << pose.translation() - truth.translation(), vectorFromRotation(pose.linear() * truth.linear().transpose());
  return error;
}

double targetError(const RigidTransform& pose, const RigidTransform& truth)
{
  return (pose * traceTarget() - truth * traceTarget()).norm();
}

struct Score
{
  double rms = 0.0;       ///< of the target's place [mm]
  double hold_rms = 0.0;  ///< of the last measured one
  double nees = 0.0;      ///< mean normalised squared error, 6 expected
  double inside = 0.0;    ///< share of errors in the 95 % ellipsoid
};

/// Predictions 115 ms ahead, from 10 s on, over `seeds` runs of 60 s. `interval` says how long after an exposure the
/// next one is [s].
template <typename Interval>
Score scoreOf(const NamedMotion& motion, unsigned seeds, double sigma, const Interval& interval)
{
  const double bound = boost::math::quantile(boost::math::chi_squared(6), 0.95);
  Score score;
  double count = 0.0;
  for (unsigned seed = 100; seed < 100 + seeds; ++seed)
  {
    const MotionTrace trace = motion.make(seed, 62.0);
    NoisyTracker tracker{ sigmas(sigma, 0.02 * sigma), std::mt19937(seed + 7000) };
    PosePredictor predictor({}, traceTarget());
    for (double time = 0.0; time < 60.0; time += interval(tracker.random))
    {
      const auto [pose, covariance] = tracker.measure(trace(time));
      const std::int64_t stamp = std::llround(1e9 * time);
      EXPECT_TRUE(predictor.add(stamp, pose, covariance));
      if (time < 10.0)
      {
        continue;
      }
      const RigidTransform truth = tracePose(trace(time + 0.115));
      const auto prediction = predictor.predict(stamp + kLatency);
      const Vector6d error = poseError(prediction->room_from_patient, truth);
      const double squared = error.dot(prediction->covariance.ldlt().solve(error));
      score.rms += std::pow(targetError(prediction->room_from_patient, truth), 2);
      score.hold_rms += std::pow(targetError(pose, truth), 2);
      score.nees += squared;
      score.inside += squared < bound ? 1.0 : 0.0;
      ++count;
    }
  }
  return { std::sqrt(score.rms / count), std::sqrt(score.hold_rms / count), score.nees / count, score.inside / count };
}

double regular(std::mt19937&)
{
  return kExposureInterval;
}

TEST(PosePredictor, BeatsHoldByHalfWhileBreathing)
{
  for (const double sigma : { 0.05, 0.1 })
  {
    const Score score = scoreOf({ "breathing", breathing }, 5, sigma, regular);
    EXPECT_LT(score.rms, 0.5 * score.hold_rms) << sigma;
    RecordProperty("breathing_rms_um", std::to_string(1e3 * score.rms));
  }
}

// The noise of a measured place is sigma in each axis; a predictor that knows when to stand still gets below it.
TEST(PosePredictor, IsNoWorseThanHoldWithoutBreathing)
{
  for (const NamedMotion& motion : { NamedMotion{ "drift", drift }, NamedMotion{ "random walk", wander } })
  {
    const Score score = scoreOf(motion, 3, 0.075, regular);
    EXPECT_LT(score.rms, score.hold_rms) << motion.name;
  }
}

// Exposures come 10 to 60 ms apart, every fifth is missing.
TEST(PosePredictor, CopesWithIrregularExposures)
{
  const auto interval = [](std::mt19937& random)
  {
    double sum = 0.0;
    do
    {
      sum += std::uniform_real_distribution<double>(0.01, 0.06)(random);
    } while (std::uniform_real_distribution<double>()(random) < 0.2);
    return sum;
  };
  const Score score = scoreOf({ "breathing", breathing }, 5, 0.075, interval);
  EXPECT_LT(score.rms, 0.5 * score.hold_rms);
  EXPECT_GT(score.inside, 0.88);
}

// The mean of the normalised squared error is 6 for a covariance that is right. Errors of one run are not independent,
// but those that are a second apart nearly are: 10 runs of 50 give chi-square with 3000 degrees of freedom, 6 % either
// way at 1 in 1000. The motions are none of the models, for which a quarter is allowed besides.
TEST(PosePredictor, CovarianceIsCalibrated)
{
  for (const NamedMotion& motion : { NamedMotion{ "breathing", breathing }, NamedMotion{ "random walk", wander } })
  {
    const Score score = scoreOf(motion, 10, 0.075, regular);
    const boost::math::chi_squared sum(10 * 50 * 6);
    EXPECT_GT(score.nees, 0.75 * boost::math::quantile(sum, 0.0005) / 500.0) << motion.name;
    EXPECT_LT(score.nees, 1.25 * boost::math::quantile(sum, 0.9995) / 500.0) << motion.name;
    EXPECT_GT(score.inside, 0.88) << motion.name;
  }
}

TEST(PosePredictor, CovarianceGrowsWithTheHorizon)
{
  for (const NamedMotion& motion : allMotions())
  {
    const MotionTrace trace = motion.make(5, 62.0);
    NoisyTracker tracker{ sigmas(0.075, 0.002), std::mt19937(11) };
    PosePredictor predictor({}, traceTarget());
    for (int i = 0; i < 1800; ++i)
    {
      const auto [pose, covariance] = tracker.measure(trace(i * kExposureInterval));
      const std::int64_t stamp = std::llround(1e9 * i * kExposureInterval);
      predictor.add(stamp, pose, covariance);
      double last = 0.0;
      for (int step = 0; i >= 300 && i % 10 == 0 && step <= 13; ++step)
      {
        const auto prediction = predictor.predict(stamp + 50 * step * kMillisecond);
        const double trace_now =
            covarianceAt(traceTarget(), prediction->room_from_patient, prediction->covariance).trace();
        EXPECT_GT(trace_now, last) << motion.name << " at exposure " << i << ", " << 50 * step << " ms";
        last = trace_now;
      }
    }
  }
}

/// Exact poses at 30 Hz from 0 on.
std::int64_t feed(PosePredictor& predictor, int exposures, const std::function<Vector6d(double)>& motion,
                  const Matrix6d& at_target)
{
  std::int64_t stamp = 0;
  for (int i = 0; i < exposures; ++i)
  {
    stamp = std::llround(1e9 * i * kExposureInterval);
    const RigidTransform pose = tracePose(motion(1e-9 * static_cast<double>(stamp)));
    predictor.add(stamp, pose, covarianceAtOrigin(pose, at_target));
  }
  return stamp;
}

TEST(PosePredictor, FollowsSteadyMotionAndRotation)
{
  const auto motion = [](double time)
  { return Vector6d((Vector6d() << 10.0 * time, -4.0 * time, 1.0, 0.0, 0.02 * time, 0.0).finished()); };
  PosePredictor predictor({}, traceTarget());
  const std::int64_t stamp = feed(predictor, 150, motion, sigmas(0.05, 0.001).cwiseAbs2().asDiagonal());
  const auto prediction = predictor.predict(stamp + kLatency);
  const Vector6d truth = motion(1e-9 * static_cast<double>(stamp + kLatency));
  // A tenth of a noisy exposure's error.
  EXPECT_LT(targetError(prediction->room_from_patient, tracePose(truth)), 0.02);
  EXPECT_LT(poseError(prediction->room_from_patient, tracePose(truth)).tail<3>().norm(), 4e-4);
  EXPECT_EQ(prediction->stamp, stamp + kLatency);
}

// An error that is the same in every exposure, as that of a rotation that nobody measures, is not averaged away.
TEST(PosePredictor, KeepsWhatNoFilterCanRemove)
{
  Matrix6d at_target = sigmas(0.2, 0.0175).cwiseAbs2().asDiagonal();
  at_target(0, 1) = at_target(1, 0) = 0.02;
  PosePredictor predictor({}, traceTarget());
  const std::int64_t stamp = feed(
      predictor, 600, [](double) { return Vector6d(Vector6d::Zero()); }, at_target);
  const auto prediction = predictor.predict(stamp);
  const Matrix6d predicted = covarianceAt(traceTarget(), prediction->room_from_patient, prediction->covariance);
  EXPECT_NEAR(predicted(0, 0), 0.04, 0.02 * 0.04);
  EXPECT_NEAR(predicted(0, 1), 0.02, 0.02 * 0.02);
  EXPECT_NEAR(predicted(4, 4), 0.0175 * 0.0175, 0.02 * 0.0175 * 0.0175);
  EXPECT_LT(poseError(prediction->room_from_patient, tracePose(Vector6d::Zero())).norm(), 1e-9);
}

// It is an error that stays: nothing is filtered otherwise, from the first exposure on.
TEST(PosePredictor, TissueOnlyAddsToTheCovariance)
{
  PosePredictor with({}, traceTarget());
  PosePredictor without({}, traceTarget());
  const MotionTrace trace = breathing(5, 5.0);
  NoisyTracker tracker{ sigmas(0.1, 0.002), std::mt19937(6) };
  for (double time = 0.0; time < 3.0; time += kExposureInterval)
  {
    const auto [pose, covariance] = tracker.measure(trace(time));
    const std::int64_t stamp = std::llround(1e9 * time);
    Matrix6d more = covariance;
    more.diagonal().head<3>().array() += 1.0;
    ASSERT_TRUE(with.add(stamp, pose, more, 1.0) && without.add(stamp, pose, covariance));
    const PosePrediction a = *with.predict(stamp + kLatency);
    const PosePrediction b = *without.predict(stamp + kLatency);
    EXPECT_LT(poseError(a.room_from_patient, b.room_from_patient).norm(), 1e-6);
    const Matrix6d added = covarianceAt(traceTarget(), a.room_from_patient, a.covariance) -
                           covarianceAt(traceTarget(), b.room_from_patient, b.covariance);
    EXPECT_LT((added.diagonal().head<3>().array() - 1.0).abs().maxCoeff(), 1e-6);
    EXPECT_LT(added.diagonal().tail<3>().cwiseAbs().maxCoeff(), 1e-9);
  }
}

TEST(PosePredictor, StartsOverAfterAGap)
{
  const Matrix6d at_target = sigmas(0.05, 0.001).cwiseAbs2().asDiagonal();
  const auto motion = [](double time) { return Vector6d(10.0 * time * Vector6d::Unit(0)); };
  PosePredictor predictor({}, traceTarget());
  EXPECT_FALSE(predictor.predict(0));
  const std::int64_t stamp = feed(predictor, 90, motion, at_target);
  EXPECT_TRUE(predictor.predict(stamp + 1000 * kMillisecond));
  EXPECT_FALSE(predictor.predict(stamp + 1001 * kMillisecond));
  EXPECT_FALSE(predictor.predict(stamp - 1));

  const RigidTransform later = tracePose(Vector6d::Constant(0.3));
  const std::int64_t later_stamp = stamp + 1100 * kMillisecond;
  EXPECT_TRUE(predictor.add(later_stamp, later, covarianceAtOrigin(later, at_target)));
  const auto prediction = predictor.predict(later_stamp + kLatency);
  // At rest as far as it knows, at up to 20 mm/s as far as it fears.
  EXPECT_LT(targetError(prediction->room_from_patient, later), 1e-9);
  EXPECT_GT(covarianceAt(traceTarget(), later, prediction->covariance)(0, 0), 0.5);

  predictor.reset();
  EXPECT_FALSE(predictor.predict(later_stamp));
  EXPECT_TRUE(predictor.add(0, later, covarianceAtOrigin(later, at_target)));
}

TEST(PosePredictor, ACorrectionIsNoMotion)
{
  Twist correction_twist;
  correction_twist << 0.0, 0.03, 0.01, 1.0, -0.5, 2.0;
  const MotionTrace trace = breathing(3, 62.0);
  NoisyTracker tracker{ sigmas(0.05, 0.001), std::mt19937(1) };
  PosePredictor corrected({}, traceTarget());
  PosePredictor twin({}, traceTarget());
  for (int i = 0; i < 600; ++i)
  {
    const auto [pose, covariance] = tracker.measure(trace(i * kExposureInterval));
    const RigidTransform after = motionAbout(pose * traceTarget(), correction_twist) * pose;
    const std::int64_t stamp = std::llround(1e9 * i * kExposureInterval);
    twin.add(stamp, pose, covariance);
    const RigidTransform& seen = i < 300 ? pose : after;
    corrected.add(stamp, seen, covarianceAtOrigin(seen, tracker.sigma.cwiseAbs2().asDiagonal()));
    if (i == 299)
    {
      corrected.correct(pose, after);
    }
    if (i >= 299)
    {
      const auto expected = twin.predict(stamp + kLatency);
      const auto actual = corrected.predict(stamp + kLatency);
      const Eigen::Vector3d moved =
          actual->room_from_patient * traceTarget() - expected->room_from_patient * traceTarget();
      EXPECT_LT((moved - correction_twist.tail<3>()).norm(), 1e-6) << i;
      // The rotation's chart is not quite flat: a breath of 1 degree on a correction of 2.
      EXPECT_LT(rotationAngle(RigidTransform(rotationFromVector(correction_twist.head<3>()) *
                                             expected->room_from_patient.linear() *
                                             actual->room_from_patient.linear().transpose())),
                1e-3)
          << i;
    }
  }
}

TEST(PosePredictor, IgnoresWhatIsNoNewPose)
{
  const RigidTransform pose = tracePose(Vector6d::Zero());
  const Matrix6d covariance = covarianceAtOrigin(pose, sigmas(0.05, 0.001).cwiseAbs2().asDiagonal());
  PosePredictor predictor({}, traceTarget());
  EXPECT_TRUE(predictor.add(1000, pose, covariance));
  EXPECT_FALSE(predictor.add(1000, pose, covariance));
  EXPECT_FALSE(predictor.add(999, pose, covariance));
  RigidTransform broken = pose;
  broken.translation().y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(predictor.add(2000, broken, covariance));
  EXPECT_FALSE(predictor.add(2000, pose, covariance * std::numeric_limits<double>::infinity()));
  EXPECT_FALSE(predictor.add(2000, pose, Matrix6d::Zero()));
  EXPECT_TRUE(predictor.add(2000, pose, covariance));
}

TEST(PosePredictor, AllocatesNothing)
{
  const MotionTrace trace = breathing(3, 12.0);
  NoisyTracker tracker{ sigmas(0.05, 0.001), std::mt19937(1) };
  PosePredictor predictor({}, traceTarget());
  const long before = HeapWatch::allocations;
  for (int i = 0; i < 300; ++i)
  {
    const auto [pose, covariance] = tracker.measure(trace(i * kExposureInterval));
    const HeapWatch watch;
    predictor.add(std::llround(1e9 * i * kExposureInterval), pose, covariance);
    EXPECT_TRUE(predictor.predict(std::llround(1e9 * i * kExposureInterval) + kLatency).has_value());
  }
  EXPECT_EQ(HeapWatch::allocations, before);
  {
    const HeapWatch watch;
    const std::vector<int> allocation(10);
  }
  EXPECT_GT(HeapWatch::allocations, before);  // the watch works
}

TEST(PosePredictor, RefusesBadOptions)
{
  PosePredictorOptions options;
  options.latency = 0.0;
  EXPECT_THROW(PosePredictor(options, traceTarget()), std::invalid_argument);
  options = {};
  options.max_gap = 0.1;
  EXPECT_THROW(PosePredictor(options, traceTarget()), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
