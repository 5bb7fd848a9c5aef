#include <cstdio>

#include "scene.h"

namespace xray_tracking
{
namespace
{
// The covariance is calibrated if the squared error in its units is distributed as chi-square with six degrees of
// freedom. Motions are drawn as the options say: any translation, rotations from the prior. Of 36 sums that are
// compared with 95 % bounds one or two lie outside for an arbitrary seed; over 20,000 trials all means are within 1.5
// %.
TEST(Covariance, NormalisedErrorIsWithinItsBounds)
{
  constexpr int kTrials = 1000;
  constexpr std::uint64_t kSeed = 600;
  for (const TrackModel model :
       { TrackModel::TRANSLATION, TrackModel::EUCLIDEAN, TrackModel::SIMILARITY, TrackModel::AFFINE })
  {
    for (const std::size_t count : { 2, 3, 8 })
    {
      Random random(kSeed + 7 * count + static_cast<std::size_t>(model));
      const Scene scene{ count == 2 ? cyberknife() : viewsAround(count), { 12.0, -9.0, 15.0 } };
      MotionEstimationOptions options;
      options.floor_sigma = 0.2 * kPixel;
      options.linear_floor_sigma = 0.003;
      options.rotation_sigma = 1.5 * kDegree;
      options.significance = 0.05;
      const MotionEstimator estimator = scene.estimator(options);
      double squared_error = 0.0;
      double chi_square = 0.0;
      int degrees_of_freedom = 0;
      int flagged = 0;
      for (int trial = 0; trial < kTrials; ++trial)
      {
        const Eigen::Vector3d rotation = options.rotation_sigma * random.normals(3);
        const Eigen::Vector3d translation = random.inCube(8.0);
        auto tracks = scene.exactTracks(scene.motion(rotation, translation), model);
        for (auto& measurement : tracks)
        {
          random.disturb(measurement->track, options);
        }
        const MotionEstimate estimate = estimator.estimate(tracks);
        ASSERT_TRUE(estimate.status == EstimateStatus::OK || estimate.status == EstimateStatus::INCONSISTENT)
            << estimate.reason;
        // The error as the covariance is defined: of the target's centre, and the rotation that leads on to the truth.
        Vector6d error;
        error << translation - estimate.translation,
            vectorFromRotation(rotationFromVector(rotation) * rotationFromVector(estimate.rotation).transpose());
        squared_error += error.dot(estimate.covariance.llt().solve(error));
        chi_square += estimate.chi_square;
        degrees_of_freedom = estimate.degrees_of_freedom;
        flagged += estimate.status == EstimateStatus::INCONSISTENT ? 1 : 0;
      }
      const std::string what =
          std::to_string(static_cast<int>(model)) + " parameters, " + std::to_string(count) + " views";
      std::printf("[ figures  ] %s: NEES %.3f of 6, chi-square %.3f of %d, %d of %d flagged at 5 %%\n", what.c_str(),
                  squared_error / kTrials, chi_square / kTrials, degrees_of_freedom, flagged, kTrials);
      expectChiSquare(squared_error, 6.0 * kTrials, "squared error, " + what);
      expectChiSquare(chi_square, static_cast<double>(degrees_of_freedom) * kTrials, "residuals, " + what);
      // 95 % bounds of the binomial about 50.
      EXPECT_GT(flagged, 36) << what;
      EXPECT_LT(flagged, 64) << what;
    }
  }
}

// Tissue that moves otherwise by 1 mm, which all views take for the target's motion.
TEST(Covariance, HasTheTissueThatNoTrackTellsOf)
{
  constexpr int kTrials = 1000;
  const Scene scene{ cyberknife(), { 12.0, -9.0, 15.0 } };
  MotionEstimationOptions options;
  options.floor_sigma = 0.2 * kPixel;
  const auto squaredError = [&](double tissue_sigma, std::optional<double> since_anchor = std::nullopt)
  {
    options.tissue_sigma = tissue_sigma;
    const double share = std::min(1.0, since_anchor.value_or(1e9) / options.tissue_time);
    const MotionEstimator estimator = scene.estimator(options);
    Random random(3);
    double sum = 0.0;
    for (int trial = 0; trial < kTrials; ++trial)
    {
      const Eigen::Vector3d translation = random.inCube(8.0);
      const Eigen::Vector3d tissue = std::sqrt(share) * random.normals(3);
      auto tracks = scene.exactTracks(Eigen::Vector3d(translation + tissue));
      for (auto& measurement : tracks)
      {
        random.disturb(measurement->track, options);
        measurement->since_anchor = since_anchor;
      }
      const MotionEstimate estimate = estimator.estimate(tracks);
      EXPECT_NEAR(estimate.tissue_variance, share * tissue_sigma * tissue_sigma, 1e-12);
      const Eigen::Vector3d error = translation - estimate.translation;
      const Eigen::Matrix3d covariance = estimate.covariance.topLeftCorner<3, 3>();
      sum += error.dot(covariance.llt().solve(error));
    }
    return sum;
  };
  expectChiSquare(squaredError(1.0), 3.0 * kTrials, "tissue of 1 mm");
  EXPECT_GT(squaredError(0.0), 30.0 * 3.0 * kTrials);
  // Since an anchor its variance has grown in proportion to the time, up to there.
  for (const double share : { 0.0, 0.3, 0.7, 1.0, 5.0 })
  {
    expectChiSquare(squaredError(1.0, share * options.tissue_time), 3.0 * kTrials, "tissue since the anchor");
  }
}
// Tissue that feigns a rotation besides, a degree a millimetre, as far as the estimate follows what is measured.
TEST(Covariance, HasTheRotationThatTissueFeigns)
{
  constexpr int kTrials = 1000;
  const Scene scene{ cyberknife(), { 12.0, -9.0, 15.0 } };
  for (const TrackModel model : { TrackModel::TRANSLATION, TrackModel::EUCLIDEAN, TrackModel::AFFINE })
  {
    MotionEstimationOptions options;
    options.floor_sigma = 0.2 * kPixel;
    options.linear_floor_sigma = 0.003;
    options.rotation_sigma = 1.5 * kDegree;
    options.tissue_sigma = 0.7;
    const MotionEstimator estimator = scene.estimator(options);
    Random random(11 + static_cast<std::size_t>(model));
    double squared_error = 0.0;
    double of_rotation = 0.0;
    for (int trial = 0; trial < kTrials; ++trial)
    {
      const Eigen::Vector3d rotation = options.rotation_sigma * random.normals(3);
      const Eigen::Vector3d translation = random.inCube(8.0);
      const Eigen::Vector3d feigned = 0.7 * kDegree * random.normals(3);
      const Eigen::Vector3d tissue = 0.7 * random.normals(3);
      auto tracks = scene.exactTracks(scene.motion(rotation + feigned, translation + tissue), model);
      for (auto& measurement : tracks)
      {
        random.disturb(measurement->track, options);
      }
      const MotionEstimate estimate = estimator.estimate(tracks);
      Vector6d error;
      error << translation - estimate.translation,
          vectorFromRotation(rotationFromVector(rotation) * rotationFromVector(estimate.rotation).transpose());
      squared_error += error.dot(estimate.covariance.llt().solve(error));
      const Eigen::Vector3d turned = error.tail<3>();
      of_rotation += turned.dot(estimate.covariance.bottomRightCorner<3, 3>().llt().solve(turned));
    }
    const std::string what = std::to_string(static_cast<int>(model)) + " parameters, ";
    expectChiSquare(squared_error, 6.0 * kTrials, what + "pose");
    expectChiSquare(of_rotation, 3.0 * kTrials, what + "rotation");
  }
}
}  // namespace
}  // namespace xray_tracking
