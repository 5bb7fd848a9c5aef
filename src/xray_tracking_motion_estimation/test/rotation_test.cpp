#include <algorithm>
#include <cstdio>

#include "scene.h"
#include "xray_tracking_motion_estimation/region_patch.h"

namespace xray_tracking
{
namespace
{
const std::vector<TrackModel> kModels = { TrackModel::TRANSLATION, TrackModel::EUCLIDEAN, TrackModel::SIMILARITY,
                                          TrackModel::AFFINE };

TEST(Warp, PredictionAndDerivativesMatchFiniteDifferences)
{
  Random random;
  for (int trial = 0; trial < 20; ++trial)
  {
    const Scene scene{ viewsAround(8), random.inCube(40.0) };
    const std::size_t view = static_cast<std::size_t>(trial) % 8;
    const ProjectionGeometry geometry = geometriesOf(scene.views)[view];
    const Eigen::Vector2d beside(random.uniform(-60.0, 60.0), random.uniform(-60.0, 60.0));
    const RigidTransform motion = scene.motion(random.inCube(0.1), random.inCube(15.0));
    const Track track = scene.exactTrack(view, TrackModel::AFFINE, motion, initialPose(), beside);
    const RegionPatch patch = RegionPatch::make(geometry, initialPose(), scene.targetCentre(),
                                                TargetShape::isotropic(scene.targetCentre()), track.centre);
    Matrix6d jacobian;
    const Eigen::Vector3d target = motion * scene.target;
    const Vector6d warp = patch.predict(geometry, target, motion.linear(), jacobian);
    // The patch has the tangents of the target's centre: in the region's, 20 mm away, perspective has changed them by
    // (20 / 2600)^2 and, where the plane is oblique to the panel, by 0.015 * 20 / 2600.
    EXPECT_LT((warp.head<2>() - track.displacement).norm(), 0.01) << trial;
    EXPECT_LT((warp - track.warp()).tail<4>().norm(), 4e-4) << trial;

    // The derivative, where nothing is turned out of the plane.
    const Eigen::Matrix3d in_plane =
        Eigen::AngleAxisd(random.uniform(-0.2, 0.2), (patch.arm + scene.target - geometry.source()).normalized())
            .toRotationMatrix();
    patch.predict(geometry, target, in_plane, jacobian);
    const double step = 1e-4;
    for (int parameter = 0; parameter < 6; ++parameter)
    {
      const auto at = [&](double change)
      {
        Vector6d twist = change * Vector6d::Unit(parameter);
        twist.head<3>() += target;
        Matrix6d unused;
        return patch.predict(geometry, twist.head<3>(), rotationFromVector(twist.tail<3>()) * in_plane, unused);
      };
      const Vector6d numeric = (at(step) - at(-step)) / (2.0 * step);
      // Third derivatives and rounding: 1e-8 of the largest numbers, px per rad.
      EXPECT_LT((numeric - jacobian.col(parameter)).norm(), 1e-6 * (1.0 + jacobian.col(parameter).norm()));
    }
  }
}

TEST(Warp, NearestParametersAreThoseOfLeastSquares)
{
  Random random;
  for (int trial = 0; trial < 20; ++trial)
  {
    // Points with the moments of a long, oblique region.
    std::vector<Eigen::Vector2d> points;
    Eigen::Matrix2d moments = Eigen::Matrix2d::Zero();
    for (int i = 0; i < 50; ++i)
    {
      const Eigen::Vector2d n = random.normals(2);
      points.emplace_back(30.0 * n.x() + 5.0 * n.y(), 12.0 * n.y());
      moments += points.back() * points.back().transpose();
    }
    Vector6d warp;
    warp << 3.0, -4.0, Eigen::Vector4d(1.0, 0.0, 0.0, 1.0) + 0.1 * random.normals(4);
    const Eigen::Matrix2d linear = (Eigen::Matrix2d() << warp(2), warp(3), warp(4), warp(5)).finished();
    const auto cost = [&](const Eigen::Matrix2d& candidate)
    {
      double sum = 0.0;
      for (const Eigen::Vector2d& point : points)
      {
        sum += (candidate * point - linear * point).squaredNorm();
      }
      return sum;
    };
    for (const TrackModel model : kModels)
    {
      TrackParametersJacobian jacobian;
      const TrackParameters parameters = nearestParameters(model, warp, moments, jacobian);
      ASSERT_EQ(parameters.size(), static_cast<int>(model));
      EXPECT_EQ(Eigen::Vector2d(parameters.head<2>()), Eigen::Vector2d(3.0, -4.0));
      for (int i = 0; i < 6; ++i)
      {
        TrackParametersJacobian unused;
        const double step = 1e-6;
        const Vector6d h = step * Vector6d::Unit(i);
        const TrackParameters slope = difference(model, nearestParameters(model, warp + h, moments, unused),
                                                 nearestParameters(model, warp - h, moments, unused)) /
                                      (2.0 * step);
        EXPECT_LT((slope - jacobian.col(i)).norm(), 1e-8);
      }
      if (model == TrackModel::EUCLIDEAN)
      {
        const double angle = parameters(2);
        EXPECT_LT(cost(Eigen::Rotation2Dd(angle).toRotationMatrix()),
                  cost(Eigen::Rotation2Dd(angle + 1e-4).toRotationMatrix()));
        EXPECT_LT(cost(Eigen::Rotation2Dd(angle).toRotationMatrix()),
                  cost(Eigen::Rotation2Dd(angle - 1e-4).toRotationMatrix()));
      }
      if (model == TrackModel::SIMILARITY)
      {
        const auto similarity = [](double a, double b) { return (Eigen::Matrix2d() << a, -b, b, a).finished(); };
        const double least = cost(similarity(parameters(2), parameters(3)));
        for (const Eigen::Vector2d& step : { Eigen::Vector2d(1e-4, 0.0), Eigen::Vector2d(0.0, 1e-4) })
        {
          EXPECT_LT(least, cost(similarity(parameters(2) + step.x(), parameters(3) + step.y())));
          EXPECT_LT(least, cost(similarity(parameters(2) - step.x(), parameters(3) - step.y())));
        }
      }
    }
  }
}

TEST(LeastSquares, IsExactForTranslationsWhateverTheTrackersModel)
{
  Random random;
  for (const TrackModel model : kModels)
  {
    for (const std::size_t count : { 2, 3, 8 })
    {
      for (int trial = 0; trial < 50; ++trial)
      {
        const Scene scene{ viewsAround(count), random.inCube(50.0) };
        const Eigen::Vector3d motion = random.inCube(15.0);
        const MotionEstimate estimate =
            scene.estimator(MotionEstimationOptions()).estimate(scene.exactTracks(motion, model));
        ASSERT_EQ(estimate.status, EstimateStatus::OK) << estimate.reason;
        EXPECT_LT((estimate.translation - motion).norm(), 1e-6 * motion.norm());
        EXPECT_LT(estimate.rotation.norm(), 1e-7);
        EXPECT_EQ(estimate.degrees_of_freedom, static_cast<int>(model) * static_cast<int>(count) - 3);
      }
    }
  }
}

MotionEstimationOptions sharpOptions(EstimationMethod method = EstimationMethod::LEAST_SQUARES)
{
  MotionEstimationOptions options = optionsFor(method);
  options.floor_sigma = 1e-3 * kPixel;
  options.linear_floor_sigma = 1e-5;
  options.significance = 1e-12;
  return options;
}

void makeSharp(Measurements& tracks)
{
  for (auto& measurement : tracks)
  {
    measurement->track.covariance.setZero();
  }
}

// Three views that are not orthogonal see every rotation in some plane; with tracks without error the prior counts for
// nothing and the motion has to come out.
TEST(LeastSquares, FindsRotationsThatAreSeen)
{
  Random random;
  for (const TrackModel model : { TrackModel::EUCLIDEAN, TrackModel::SIMILARITY, TrackModel::AFFINE })
  {
    for (int trial = 0; trial < 50; ++trial)
    {
      const Scene scene{ { viewAt("a", 50 * kDegree), viewAt("b", -40 * kDegree),
                           viewAt("c", 60 * kDegree, 80 * kDegree) },
                         random.inCube(30.0) };
      const Eigen::Vector3d rotation = random.inCube(4 * kDegree);
      const Eigen::Vector3d translation = random.inCube(8.0);
      auto tracks = scene.exactTracks(scene.motion(rotation, translation), model);
      makeSharp(tracks);
      const MotionEstimate estimate = scene.estimator(sharpOptions()).estimate(tracks);
      ASSERT_NE(estimate.status, EstimateStatus::INVALID) << estimate.reason;
      // 1e-5 of floor and a prior of 2 degrees; for the models that are not affine also the flattening of an
      // out-of-plane rotation and the perspective of a target off the axis (4 degrees times 0.01).
      const double tolerance = (model == TrackModel::AFFINE ? 0.01 : 0.06) * kDegree;
      EXPECT_LT((estimate.rotation - rotation).cwiseAbs().maxCoeff(), tolerance) << static_cast<int>(model);
      EXPECT_LT((estimate.translation - translation).norm(), 1e-3);
      const RigidTransform pose = scene.motion(rotation, translation) * initialPose();
      EXPECT_LT(rotationAngle(estimate.room_from_patient.inverse() * pose), 2.0 * tolerance);
      EXPECT_LT((estimate.room_from_patient * scene.targetCentre() - pose * scene.targetCentre()).norm(), 1e-3);
    }
  }
}

TEST(LeastSquares, SaysOfAnUnseenRotationThatItIsNotSeen)
{
  const Scene scene{ cyberknife(), Eigen::Vector3d::Zero() };
  const MotionEstimationOptions options;
  const Eigen::Vector3d shared = Eigen::Vector3d::UnitX();
  for (const TrackModel model : kModels)
  {
    // Out of both planes.
    const MotionEstimate estimate =
        scene.estimator(options).estimate(scene.exactTracks(scene.motion(2 * kDegree * shared, { 1, 2, 3 }), model));
    ASSERT_EQ(estimate.status, EstimateStatus::OK) << estimate.reason;
    EXPECT_LT(std::abs(estimate.rotation.dot(shared)), 0.05 * kDegree);
    const Eigen::Matrix3d rotation = estimate.covariance.bottomRightCorner<3, 3>();
    EXPECT_NEAR(std::sqrt(shared.dot(rotation * shared)), options.rotation_sigma, 0.01 * options.rotation_sigma);
    const double seen = std::sqrt(Eigen::Vector3d::UnitY().dot(rotation * Eigen::Vector3d::UnitY()));
    if (model == TrackModel::TRANSLATION)
    {
      EXPECT_NEAR(seen, options.rotation_sigma, 1e-6);
    }
    else
    {
      // 0.005 of floor and 0.001 of the track in each of two numbers that the angle is the mean of.
      EXPECT_NEAR(seen, std::sqrt((2.5e-5 + 1e-6) / 2.0), 1e-4);
    }
  }
}

// With the shape of the target known, depth that grows along the image turns an out-of-plane rotation into shear.
TEST(LeastSquares, SeesAnOutOfPlaneRotationOfATargetOfKnownShape)
{
  Random random;
  // Flat and oblique to both views, in room axes about the target.
  std::vector<Eigen::Vector3d> points;
  const Eigen::Matrix3d tilt =
      (Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ())).matrix();
  for (int i = 0; i < 400; ++i)
  {
    points.emplace_back(tilt * random.inCube(1.0).cwiseProduct(Eigen::Vector3d(20.0, 30.0, 4.0)));
  }
  const Scene scene{ cyberknife(), Eigen::Vector3d::Zero() };
  std::vector<Eigen::Vector3d> in_patient;
  for (const Eigen::Vector3d& point : points)
  {
    in_patient.push_back(initialPose().inverse() * point);
  }
  const Eigen::Vector3d rotation = Eigen::Vector3d(2.0, -1.0, 1.5) * kDegree;
  const Eigen::Vector3d translation(4.0, -3.0, 2.0);
  const RigidTransform motion = scene.motion(rotation, translation);
  Measurements tracks;
  for (const DetectorDescription& view : scene.views)
  {
    // The affine warp of the projected points by linear least squares.
    Eigen::MatrixXd before(points.size(), 3);
    Eigen::MatrixXd after(points.size(), 2);
    Track track;
    track.model = TrackModel::AFFINE;
    track.centre = pixelOf(view, scene.target) + Eigen::Vector2d(15.0, -10.0);
    for (std::size_t i = 0; i < points.size(); ++i)
    {
      const Eigen::Vector2d pixel = pixelOf(view, points[i]);
      before.row(static_cast<int>(i)) << 1.0, (pixel - track.centre).transpose();
      after.row(static_cast<int>(i)) = (pixelOf(view, motion * points[i]) - track.centre).transpose();
    }
    const Eigen::MatrixXd solution = before.colPivHouseholderQr().solve(after);
    track.displacement = solution.row(0).transpose();
    track.linear = solution.bottomRows(2).transpose();
    tracks.push_back(ViewMeasurement{ initialPose(), track });
  }
  const auto rotationOf = [&](const TargetShape& shape)
  {
    const MotionEstimator estimator(sharpOptions(), geometriesOf(scene.views), scene.targetCentre(), shape,
                                    initialPose());
    return estimator.estimate(tracks);
  };
  const MotionEstimate estimate = rotationOf(TargetShape::fromPoints(in_patient));
  // What is left is second order: the spread about the plane times angle squared and perspective.
  EXPECT_LT((estimate.rotation - rotation).norm(), 0.15 * kDegree) << estimate.rotation.transpose() / kDegree;
  EXPECT_LT((estimate.translation - translation).norm(), 0.05);
  // Shear that is not understood is taken for in-plane rotation.
  const MotionEstimate flat = rotationOf(TargetShape::isotropic(scene.targetCentre()));
  EXPECT_GT((flat.rotation - rotation).norm(), 0.5 * kDegree);
}

TEST(Backprojection, AppliesInPlaneRotationsInOrderAboutTurnedAxes)
{
  const Scene scene{ cyberknife(), Eigen::Vector3d::Zero() };
  const MotionEstimationOptions options = sharpOptions(EstimationMethod::BACKPROJECTION);
  const auto normal = [&](std::size_t view)
  { return Eigen::Vector3d(scene.views[view].x_direction.cross(scene.views[view].y_direction)); };
  const double a = 3.0 * kDegree;
  const double b = -5.0 * kDegree;
  // First about a's axis; b's own axis turns with the patient and is turned about second.
  const Eigen::Matrix3d first = Eigen::AngleAxisd(a, normal(0)).toRotationMatrix();
  const Eigen::Matrix3d rotation = Eigen::AngleAxisd(b, first * normal(1)).toRotationMatrix() * first;
  const RigidTransform motion = scene.motion(vectorFromRotation(rotation), Eigen::Vector3d::Zero());
  for (const TrackModel model : { TrackModel::EUCLIDEAN, TrackModel::AFFINE })
  {
    const MotionEstimate estimate = scene.estimator(options).estimate(scene.exactTracks(motion, model));
    // On the central ray the angles are exact for a flat region.
    EXPECT_LT(rotationAngle(RigidTransform(rotation.transpose() * rotationFromVector(estimate.rotation))), 1e-6);
    // The other order is off by the commutator, a b, about the third axis.
    const Eigen::Matrix3d other = Eigen::AngleAxisd(b, normal(1)).toRotationMatrix() * first;
    EXPECT_NEAR(rotationAngle(RigidTransform(other.transpose() * rotationFromVector(estimate.rotation))),
                std::abs(a * b), 2e-4);
  }
}

TEST(Backprojection, CountsRotationTwiceThatObliqueViewsShare)
{
  for (const double apart : { 90.0, 60.0, 45.0 })
  {
    const Scene scene{ { viewAt("a", 0.0), viewAt("b", apart * kDegree) }, Eigen::Vector3d::Zero() };
    const Eigen::Vector3d rotation = Eigen::Vector3d(0.0, 1.0, 2.0) * kDegree;
    auto tracks = scene.exactTracks(scene.motion(rotation, Eigen::Vector3d::Zero()), TrackModel::EUCLIDEAN);
    makeSharp(tracks);
    const auto error = [&](EstimationMethod method)
    { return (scene.estimator(sharpOptions(method)).estimate(tracks).rotation - rotation).norm() / rotation.norm(); };
    const double paper = error(EstimationMethod::BACKPROJECTION);
    const double ours = error(EstimationMethod::LEAST_SQUARES);
    std::printf(
        "[ figures  ] views %.0f degrees apart: rotation by back-projection %.0f %% off, by least squares %.2f %%\n",
        apart, 100.0 * paper, 100.0 * ours);
    EXPECT_EQ(paper > 0.4, apart < 90.0);
    EXPECT_LT(ours, 0.02);
  }
}

TEST(LeastSquares, TakesRotatedReferencesOfSingleViewsIntoAccount)
{
  Random random;
  const Scene scene{ viewsAround(3), { 5.0, -8.0, 12.0 } };
  const Eigen::Vector3d rotation = Eigen::Vector3d(1.0, 2.0, -1.5) * kDegree;
  const Eigen::Vector3d translation(3.0, 1.0, -2.0);
  const RigidTransform motion = scene.motion(rotation, translation);
  Measurements tracks = scene.exactTracks(motion, TrackModel::AFFINE);
  const RigidTransform later = scene.motion(random.inCube(2 * kDegree), random.inCube(4.0)) * initialPose();
  tracks[1] = ViewMeasurement{ later, scene.exactTrack(1, TrackModel::AFFINE, motion * initialPose() * later.inverse(),
                                                       later) };
  makeSharp(tracks);
  const MotionEstimate estimate = scene.estimator(sharpOptions()).estimate(tracks);
  EXPECT_LT((estimate.rotation - rotation).norm(), 0.02 * kDegree);
  EXPECT_LT((estimate.translation - translation).norm(), 1e-3);
  // The paper's method to first order: views that are not orthogonal count shared rotation twice, so only two of them.
  const Scene two{ cyberknife(), { 5.0, -8.0, 12.0 } };
  const Eigen::Vector3d seen = Eigen::Vector3d(0.0, 2.0, -1.5) * kDegree;
  const RigidTransform turned = two.motion(seen, Eigen::Vector3d::Zero());
  Measurements pair = two.exactTracks(turned, TrackModel::EUCLIDEAN);
  const RigidTransform between = two.motion(seen / 3.0, Eigen::Vector3d::Zero()) * initialPose();
  pair[1] = ViewMeasurement{ between, two.exactTrack(1, TrackModel::EUCLIDEAN,
                                                     turned * initialPose() * between.inverse(), between) };
  const MotionEstimate paper = two.estimator(sharpOptions(EstimationMethod::BACKPROJECTION)).estimate(pair);
  // Off the axis by 1 %, and the commutator of two degrees.
  EXPECT_LT((paper.rotation - seen).norm(), 0.1 * kDegree);
}
}  // namespace
}  // namespace xray_tracking
