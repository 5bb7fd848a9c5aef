#include "xray_tracking_motion_estimation/motion_estimator.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <Eigen/Geometry>

#include "scene.h"

namespace xray_tracking
{
namespace
{
TEST(LeastSquares, IsExactAnywhereInTheFieldOfView)
{
  Random random;
  std::vector<std::vector<DetectorDescription>> arrangements = { cyberknife() };
  for (const double apart : { 90.0, 60.0, 45.0, 20.0 })
  {
    arrangements.push_back({ viewAt("a", 0.0), viewAt("b", apart * kDegree) });
  }
  for (const std::size_t count : { 2, 3, 4, 8 })
  {
    arrangements.push_back(viewsAround(count));
  }
  for (const auto& views : arrangements)
  {
    for (int trial = 0; trial < 100; ++trial)
    {
      // 512 px of 0.4 mm see 140 mm at the isocentre.
      const Scene scene{ views, random.inCube(50.0) };
      const Eigen::Vector3d motion = random.inCube(15.0);
      const MotionEstimate estimate = estimateExact(scene, motion, EstimationMethod::LEAST_SQUARES);
      ASSERT_EQ(estimate.status, EstimateStatus::OK) << estimate.reason;
      EXPECT_LT((estimate.translation - motion).norm(), 1e-6 * motion.norm());
      EXPECT_TRUE(estimate.room_from_patient.isApprox(moved(initialPose(), motion), 1e-9));
      EXPECT_LT(estimate.disagreement, 1e-6);
      EXPECT_EQ(estimate.degrees_of_freedom, 2 * static_cast<int>(views.size()) - 3);
    }
  }
}

// The weighted minimum, checked without any of the estimator's derivatives: no step in any direction improves the cost
// of tracks that contradict each other, computed by line-plane intersection.
TEST(LeastSquares, FindsTheMinimumOfInconsistentTracks)
{
  Random random;
  for (const std::size_t count : { 2, 3, 4, 8 })
  {
    const Scene scene{ viewsAround(count), { 20.0, -30.0, 25.0 } };
    auto tracks = scene.exactTracks({ 3.0, -5.0, 8.0 });
    for (auto& measurement : tracks)
    {
      const double width = 0.2 + random.uniform(0.0, 1.0);
      measurement->track.covariance.topLeftCorner<2, 2>() << width, 0.3 * width, 0.3 * width, 0.5;
      measurement->track.displacement += random.normals(2);
    }
    const MotionEstimationOptions options;
    const MotionEstimate estimate = scene.estimator(options).estimate(tracks);
    const auto cost = [&](const Eigen::Vector3d& translation)
    {
      double sum = 0.0;
      for (std::size_t i = 0; i < count; ++i)
      {
        const Eigen::Vector2d residual = pixelOf(scene.views[i], scene.target + translation) -
                                         pixelOf(scene.views[i], scene.target) - tracks[i]->track.displacement;
        const Eigen::Matrix2d covariance =
            tracks[i]->track.covariance.topLeftCorner<2, 2>() +
            std::pow(options.floor_sigma / pixelAt(scene.views[i], scene.target), 2) * Eigen::Matrix2d::Identity();
        sum += residual.dot(covariance.inverse() * residual);
      }
      return sum;
    };
    const double minimum = cost(estimate.translation);
    EXPECT_NEAR(minimum, estimate.chi_square, 1e-9 * minimum);
    EXPECT_GT(minimum, 0.01);
    for (int trial = 0; trial < 50; ++trial)
    {
      // 1e-3 mm costs about 1e-5 of chi-square; the curvature shows at every step, the slope at none.
      EXPECT_GT(cost(estimate.translation + 1e-3 * random.inCube(1.0).normalized()), minimum);
    }
  }
}

// With sources infinitely far away and orthogonal views every axis is a weighted mean that can be written down.
TEST(LeastSquares, IsTheWeightedMeanForParallelRays)
{
  const double far = 1e7;
  const Scene scene{ { viewAt("a", 0.0, 0.0, far, far), viewAt("b", 90 * kDegree, 0.0, far, far) }, { 5.0, 6.0, 7.0 } };
  MotionEstimationOptions options;
  options.significance = 1e-12;
  options.floor_sigma = 1e-6;
  auto tracks = scene.exactTracks(Eigen::Vector3d::Zero());
  tracks[0]->track.displacement = { 10.0, 20.0 };
  tracks[1]->track.displacement = { 11.0, 30.0 };
  tracks[0]->track.covariance.topLeftCorner<2, 2>() = Eigen::Vector2d(1.0, 1.0).asDiagonal();
  tracks[1]->track.covariance.topLeftCorner<2, 2>() = Eigen::Vector2d(4.0, 9.0).asDiagonal();
  const MotionEstimate estimate = scene.estimator(options).estimate(tracks);
  const double pitch = 0.4;
  // Rows of a grow along -y; turned by 90 degrees about x, those of b grow along -z.
  const Eigen::Vector3d expected(pitch * (10.0 / 1.0 + 11.0 / 4.0) / (1.0 / 1.0 + 1.0 / 4.0), -pitch * 20.0,
                                 -pitch * 30.0);
  // Rays diverge by 1e-6 of the distance from the axis.
  EXPECT_LT((estimate.translation - expected).norm(), 1e-4) << estimate.translation.transpose();
  const Eigen::Vector3d variance = pitch * pitch * Eigen::Vector3d(0.8, 1.0, 9.0);
  EXPECT_LT((estimate.covariance.topLeftCorner<3, 3>() - Eigen::Matrix3d(variance.asDiagonal())).norm(), 1e-4);
  // 1 px apart with a variance of 1 + 4 between them.
  EXPECT_NEAR(estimate.chi_square, 1.0 / 5.0, 1e-4);

  options.method = EstimationMethod::BACKPROJECTION;
  const Eigen::Vector3d mean(pitch * 10.5, -pitch * 20.0, -pitch * 30.0);
  EXPECT_LT((scene.estimator(options).estimate(tracks).translation - mean).norm(), 1e-4);
}

TEST(LeastSquares, JoinsViewsThatWereTrainedOnDifferentExposures)
{
  const Scene scene{ cyberknife(), { 10.0, 20.0, -30.0 } };
  const Eigen::Vector3d motion(4.0, -6.0, 9.0);
  auto tracks = scene.exactTracks(motion);
  // View b was trained later, when the patient had also turned about its origin, far from the target.
  RigidTransform later = moved(initialPose(), { -2.0, 7.0, 3.0 });
  later.rotate(Eigen::AngleAxisd(1 * kDegree, Eigen::Vector3d::UnitY()));
  tracks[1]->room_from_patient = later;
  tracks[1]->track.centre = pixelOf(scene.views[1], later * scene.targetCentre());
  tracks[1]->track.displacement =
      pixelOf(scene.views[1], scene.target + motion) - pixelOf(scene.views[1], later * scene.targetCentre());
  const auto estimator = scene.estimator(MotionEstimationOptions());
  EXPECT_LT((estimator.estimate(tracks).translation - motion).norm(), 1e-6 * motion.norm());

  // The same for the paper's method where it is good: to the percent that its c is off.
  const auto paper = scene.estimator(optionsFor(EstimationMethod::BACKPROJECTION));
  EXPECT_LT((paper.estimate(tracks).translation - motion).norm(), 0.03 * motion.norm());
}

// Eqs. (2)-(7) written out for the CyberKnife: columns of both views run along room x, rows at 45 degrees.
TEST(Backprojection, IsThePapersFormula)
{
  const Scene scene{ cyberknife(), { 12.0, -20.0, 35.0 } };
  auto tracks = scene.exactTracks(Eigen::Vector3d::Zero());
  tracks[0]->track.displacement = { 8.0, -3.0 };
  tracks[1]->track.displacement = { 7.5, 6.0 };
  const double half = std::sqrt(0.5);
  const Eigen::Vector3d axis_a(0.0, half, -half);
  const Eigen::Vector3d axis_b(0.0, -half, -half);
  ASSERT_NEAR((scene.views[0].source + kSourceToIsocentre * axis_a).norm(), 0.0, 1e-9);
  ASSERT_NEAR((scene.views[1].source + kSourceToIsocentre * axis_b).norm(), 0.0, 1e-9);
  const auto c = [&](const Eigen::Vector3d& axis)
  {
    const double d = kSourceToDetector - kSourceToIsocentre - scene.target.dot(axis);
    return (kSourceToDetector - d) / kSourceToDetector;
  };
  const Eigen::Vector3d d_a = c(axis_a) * 0.4 * Eigen::Vector3d(8.0, -half * -3.0, -half * -3.0);
  const Eigen::Vector3d d_b = c(axis_b) * 0.4 * Eigen::Vector3d(7.5, -half * 6.0, half * 6.0);
  const Eigen::Vector3d expected = Eigen::Vector3d(0.5, 1.0, 1.0).cwiseProduct(d_a + d_b);
  const MotionEstimate estimate = scene.estimator(optionsFor(EstimationMethod::BACKPROJECTION)).estimate(tracks);
  EXPECT_LT((estimate.translation - expected).norm(), 1e-9) << estimate.translation.transpose();
}

/// The worst of 200 motions of the given length [mm], the target standing off the planes through the isocentre.
double worstError(double off_axis, double length, EstimationMethod method)
{
  const Scene scene{ cyberknife(), { off_axis, 0.0, 0.0 } };
  Random random;
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial)
  {
    worst = std::max(worst, relativeError(scene, length * random.inCube(1.0).normalized(), method));
  }
  return worst;
}

TEST(Backprojection, IsGoodOnTheCentralRayAndPercentsOffBesideIt)
{
  for (const double off_axis : { 0.0, 38.0, 60.0 })
  {
    const double infinitesimal = worstError(off_axis, 1e-3, EstimationMethod::BACKPROJECTION);
    const double finite = worstError(off_axis, 10.0, EstimationMethod::BACKPROJECTION);
    std::printf("[ figures  ] %2.0f mm off axis: back-projection up to %.2f %% off, for motions of 10 mm %.2f %%\n",
                off_axis, 100.0 * infinitesimal, 100.0 * finite);
    // A motion along the ray is taken for one across, off_axis / distance of it; the shared axis gets the mean of two
    // rays at right angles, of which a motion along both at once has a component of sqrt(1/2) each.
    EXPECT_NEAR(infinitesimal, off_axis / kSourceToIsocentre * std::sqrt(0.5), 2e-4);
    // To second order, half of motion / distance at most from each view.
    EXPECT_LT(finite - infinitesimal, 10.0 / kSourceToIsocentre);
    EXPECT_LT(worstError(off_axis, 1e-3, EstimationMethod::LEAST_SQUARES), 1e-6);
    EXPECT_LT(worstError(off_axis, 10.0, EstimationMethod::LEAST_SQUARES), 1e-6);
  }
}

TEST(Backprojection, FailsForObliqueViewsWhereLeastSquaresDoesNot)
{
  const Eigen::Vector3d motion(0.0, 6.0, 8.0);
  for (const double apart : { 90.0, 60.0, 45.0 })
  {
    const Scene scene{ { viewAt("a", 0.0), viewAt("b", apart * kDegree) }, Eigen::Vector3d::Zero() };
    const double paper = relativeError(scene, motion, EstimationMethod::BACKPROJECTION);
    const double ours = relativeError(scene, motion, EstimationMethod::LEAST_SQUARES);
    std::printf("[ figures  ] views %.0f degrees apart: back-projection %.0f %% off, least squares %.1e\n", apart,
                100.0 * paper, ours);
    // Parallel rays, by hand: rows y_A = -y, y_B = (0, -cos, -sin); N (y_A y_A^T + y_B y_B^T) motion.
    const double c = std::cos(apart * kDegree);
    const double s = std::sin(apart * kDegree);
    const Eigen::Vector2d m(motion.y(), motion.z());
    const double seen_b = c * m.x() + s * m.y();
    const Eigen::Vector2d expected((m.x() + c * seen_b) / (1.0 + c * c), s * seen_b / (s * s));
    EXPECT_NEAR(paper, (expected - m).norm() / m.norm(), 0.01);
    EXPECT_EQ(paper > 0.4, apart < 90.0);
    EXPECT_LT(ours, 1e-6);
  }
}

TEST(Covariance, IsWhatMonteCarloFinds)
{
  constexpr int kTrials = 1000;
  for (const EstimationMethod method : { EstimationMethod::LEAST_SQUARES, EstimationMethod::BACKPROJECTION })
  {
    Random random;
    // On the axis and with little motion, so that the back-projection has no bias to speak of.
    const Scene scene{ cyberknife(), Eigen::Vector3d::Zero() };
    const Eigen::Vector3d motion(0.3, -0.2, 0.25);
    MotionEstimationOptions options = optionsFor(method);
    options.significance = 0.05;
    Eigen::Matrix2d covariance;
    covariance << 0.6, 0.2, 0.2, 0.3;
    const Eigen::Matrix2d total = covariance + std::pow(options.floor_sigma / kPixel, 2) * Eigen::Matrix2d::Identity();
    const Eigen::Matrix2d root = total.llt().matrixL();
    const MotionEstimator estimator = scene.estimator(options);
    double normalised_squared_error = 0.0;
    double chi_square = 0.0;
    int flagged = 0;
    for (int trial = 0; trial < kTrials; ++trial)
    {
      auto tracks = scene.exactTracks(motion);
      for (auto& measurement : tracks)
      {
        measurement->track.covariance.topLeftCorner<2, 2>() = covariance;
        measurement->track.displacement += root * random.normals(2);
      }
      const MotionEstimate estimate = estimator.estimate(tracks);
      const Eigen::Vector3d error = estimate.translation - motion;
      normalised_squared_error += error.dot(estimate.covariance.topLeftCorner<3, 3>().inverse() * error);
      chi_square += estimate.chi_square;
      flagged += estimate.status == EstimateStatus::INCONSISTENT ? 1 : 0;
    }
    expectChiSquare(normalised_squared_error, 3.0 * kTrials, "squared error");
    // 5 % of the good exposures are refused; 95 % bounds of the binomial. Equal covariances make the paper's mean the
    // best one, so that its residuals are those of least squares.
    expectChiSquare(chi_square, kTrials, "residuals");
    EXPECT_GT(flagged, 36);
    EXPECT_LT(flagged, 64);
  }
}

TEST(Covariance, OfThePoseCarriesTheUnknownRotationOverTheLeverArm)
{
  const Scene scene{ cyberknife(), { 10.0, 20.0, -30.0 } };
  MotionEstimationOptions options;
  options.rotation_sigma = 0.01;
  const MotionEstimate estimate = scene.estimator(options).estimate(scene.exactTracks({ 1.0, 2.0, 3.0 }));

  // Target's centre p and rotation vector d are what the error is made of: the pose R(d) R0, t = p - R(d) R0 c.
  const Eigen::Vector3d arm = initialPose().linear() * scene.targetCentre();
  ASSERT_GT(arm.norm(), 500.0);
  Eigen::Matrix<double, 6, 6> pose_by_error = Eigen::Matrix<double, 6, 6>::Identity();
  const double step = 1e-6;
  for (int axis = 0; axis < 3; ++axis)
  {
    const Eigen::AngleAxisd forward(step, Eigen::Vector3d::Unit(axis));
    const Eigen::AngleAxisd backward(-step, Eigen::Vector3d::Unit(axis));
    pose_by_error.block<3, 1>(0, 3 + axis) = (backward * arm - forward * arm) / (2.0 * step);
  }
  Eigen::Matrix<double, 6, 6> error = Eigen::Matrix<double, 6, 6>::Zero();
  error.topLeftCorner<3, 3>() = estimate.covariance.topLeftCorner<3, 3>();
  error.bottomRightCorner<3, 3>() = 1e-4 * Eigen::Matrix3d::Identity();
  const Eigen::Matrix<double, 6, 6> expected = pose_by_error * error * pose_by_error.transpose();
  EXPECT_TRUE(estimate.pose_covariance.isApprox(expected, 1e-7));
  // 500 mm at 0.01 rad; and positive definite.
  EXPECT_GT(std::sqrt(estimate.pose_covariance.topLeftCorner<3, 3>().trace()), 5.0);
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(estimate.covariance.topLeftCorner<3, 3>())
                .eigenvalues()
                .minCoeff(),
            0.0);
}

// However far apart the views are, and whatever the region's place: then the steps may not come to rest.
TEST(Consistency, GrossDisagreementIsCalledThat)
{
  const Scene scene{ cyberknife(), { 10.0, -15.0, 20.0 } };
  const MotionEstimator estimator = scene.estimator(MotionEstimationOptions());
  for (const double apart : { 5.0, 20.0, 50.0, 100.0 })
  {
    for (const double beside : { -40.0, 0.0, 40.0 })
    {
      auto tracks = scene.exactTracks({ 2.0, -3.0, 1.0 });
      tracks[0]->track.displacement.x() += apart;
      tracks[0]->track.centre.x() += beside;
      const MotionEstimate estimate = estimator.estimate(tracks);
      EXPECT_EQ(estimate.status, EstimateStatus::INCONSISTENT) << estimate.reason;
      EXPECT_GT(estimate.disagreement, 2.0);
    }
  }
}

TEST(Consistency, ThreePixelsInTheSharedAxisAreFlagged)
{
  const Scene scene{ cyberknife(), { 10.0, -15.0, 20.0 } };
  for (const EstimationMethod method : { EstimationMethod::LEAST_SQUARES, EstimationMethod::BACKPROJECTION })
  {
    const MotionEstimator estimator = scene.estimator(optionsFor(method));
    const auto exact = scene.exactTracks({ 2.0, -3.0, 1.0 });
    EXPECT_EQ(estimator.estimate(exact).status, EstimateStatus::OK);
    for (const std::size_t view : { 0, 1 })
    {
      auto shifted = exact;
      shifted[view]->track.displacement.x() += 3.0;
      const MotionEstimate estimate = estimator.estimate(shifted);
      EXPECT_EQ(estimate.status, EstimateStatus::INCONSISTENT);
      EXPECT_NE(estimate.reason.find("disagree"), std::string::npos) << estimate.reason;
      // The error is shared out between the views: half of it each.
      EXPECT_NEAR(estimate.disagreement, 1.5, 0.1);
      // 3^2 over twice (0.01 + 0.5^2).
      EXPECT_NEAR(estimate.chi_square, 9.0 / 0.52, 1.0);

      // Across the shared axis nobody else looks: this is the limit of what two views can tell.
      shifted = exact;
      shifted[view]->track.displacement.y() += 3.0;
      EXPECT_EQ(estimator.estimate(shifted).status, EstimateStatus::OK);
    }
  }
}

// Each view is wrong by an amount of its own that stays, as where tissue that moved otherwise is seen. Once the pose of
// one exposure is known from elsewhere, tracks that count from there are right.
TEST(Anchor, TakesOutWhatEachViewIsWrongBy)
{
  const std::vector<Eigen::Vector2d> wrong = { { 0.8, -0.5 }, { -0.7, 0.4 } };
  for (const TrackModel model : { TrackModel::TRANSLATION, TrackModel::AFFINE })
  {
    const Scene scene{ cyberknife(), { 10.0, -5.0, 8.0 } };
    const Eigen::Vector3d then(4.0, -3.0, 5.0);
    const Eigen::Vector3d now(-2.0, 6.0, 1.0);
    auto anchors = scene.exactTracks(then, model);
    auto tracks = scene.exactTracks(now, model);
    auto anchored = tracks;
    for (std::size_t i = 0; i < tracks.size(); ++i)
    {
      anchors[i]->track.displacement += wrong[i];
      tracks[i]->track.displacement += wrong[i];
      anchored[i] = ViewMeasurement{ moved(initialPose(), then), tracks[i]->track.since(anchors[i]->track) };
    }
    MotionEstimator estimator = scene.estimator(MotionEstimationOptions());
    const MotionEstimate plain = estimator.estimate(tracks);
    EXPECT_GT((plain.translation - now).norm(), 0.1);
    EXPECT_GT(plain.disagreement, 0.4);

    const double sigma = 0.05;
    estimator.setReference(moved(initialPose(), then), sigma * sigma * Matrix6d::Identity());
    const MotionEstimate estimate = estimator.estimate(anchored);
    // What is tracked is 0.3 mm beside the target's centre: perspective makes 1e-4 of the motion of that.
    EXPECT_LT((estimate.room_from_patient.translation() - moved(initialPose(), now).translation()).norm(), 2e-3);
    EXPECT_LT(estimate.disagreement, 2e-3);

    // The anchor's errors are in the covariance: of the tracks, and of the pose that it was given.
    estimator.setReference(moved(initialPose(), then), Matrix6d::Zero());
    const MotionEstimate certain = estimator.estimate(anchored);
    EXPECT_TRUE((estimate.covariance - certain.covariance).isApprox(sigma * sigma * Matrix6d::Identity(), 1e-6));
    EXPECT_GT(certain.covariance.diagonal().head<3>().sum(), plain.covariance.diagonal().head<3>().sum());
  }
}

// A point of the region goes the same way at once and in two steps.
TEST(Track, SinceIsTheWarpThatIsLeft)
{
  Random random;
  const auto map = [](const Track& track, const Eigen::Vector2d& x)
  { return Eigen::Vector2d(track.centre + track.displacement + track.linear * (x - track.centre)); };
  for (int trial = 0; trial < 20; ++trial)
  {
    Track anchor;
    anchor.model = TrackModel::AFFINE;
    anchor.centre = { 250.0, 260.0 };
    anchor.displacement = 10.0 * random.normals(2);
    anchor.linear += 0.05 * Eigen::Matrix2d(Eigen::Map<const Eigen::Matrix2d>(random.normals(4).eval().data()));
    Track track = anchor;
    track.displacement = 10.0 * random.normals(2);
    track.linear = Eigen::Matrix2d::Identity() +
                   0.05 * Eigen::Matrix2d(Eigen::Map<const Eigen::Matrix2d>(random.normals(4).eval().data()));
    const Eigen::Vector2d point = anchor.centre + 40.0 * random.normals(2);
    EXPECT_LT((map(track.since(anchor), map(anchor, point)) - map(track, point)).norm(), 1e-9);
  }
}

TEST(Track, SinceAnUnmeasuredLinearPartIsATranslation)
{
  Track translation;
  translation.centre = { 250.0, 260.0 };
  translation.displacement = { 3.0, -1.0 };
  translation.covariance.topLeftCorner<2, 2>() = 0.01 * Eigen::Matrix2d::Identity();
  Track euclidean = translation;
  euclidean.model = TrackModel::EUCLIDEAN;
  euclidean.displacement = { 5.0, 2.0 };
  euclidean.linear = Eigen::Rotation2Dd(0.05).toRotationMatrix();
  euclidean.covariance = 0.02 * Matrix6d::Identity() + 0.001 * Matrix6d::Ones();
  const Matrix6d sum = translation.covariance + euclidean.covariance;
  for (const bool forwards : { true, false })
  {
    const Track since = forwards ? euclidean.since(translation) : translation.since(euclidean);
    EXPECT_EQ(TrackModel::TRANSLATION, since.model);
    EXPECT_EQ(Eigen::Vector2d(forwards ? 2.0 : -2.0, forwards ? 3.0 : -3.0), since.displacement);
    EXPECT_EQ(Eigen::Matrix2d(Eigen::Matrix2d::Identity()), since.linear);
    Matrix6d expected = Matrix6d::Zero();
    expected.topLeftCorner<2, 2>() = sum.topLeftCorner<2, 2>();
    EXPECT_EQ(expected, since.covariance);
  }
  EXPECT_EQ(TrackModel::EUCLIDEAN, euclidean.since(euclidean).model);
}
}  // namespace
}  // namespace xray_tracking
