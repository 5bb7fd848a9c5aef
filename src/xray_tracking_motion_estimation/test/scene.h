#pragma once

#include <cmath>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>
#include <boost/math/distributions/chi_squared.hpp>

#include "xray_tracking_motion_estimation/motion_estimator.h"

namespace xray_tracking
{
constexpr double kDegree = M_PI / 180.0;
constexpr double kSourceToIsocentre = 2600.0;
constexpr double kSourceToDetector = 3800.0;
constexpr double kPitch = 0.4;
/// Size of the views' pixels at the isocentre [mm].
constexpr double kPixel = kPitch * kSourceToIsocentre / kSourceToDetector;

/// A view of the isocentre with columns along room x, its axis turned about room x by `angle` from straight down and
/// then about room z by `turn`.
inline DetectorDescription viewAt(const std::string& name, double angle, double turn = 0.0,
                                  double source_to_isocentre = kSourceToIsocentre,
                                  double source_to_detector = kSourceToDetector)
{
  const Eigen::Matrix3d tilt =
      (Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  const Eigen::Vector3d x = tilt * Eigen::Vector3d::UnitX();
  const Eigen::Vector3d y = tilt * -Eigen::Vector3d::UnitY();
  const Eigen::Vector3d axis = x.cross(y);
  const double pitch = kPitch;
  DetectorDescription view{ name, { 512, 512 }, { pitch, pitch }, -source_to_isocentre * axis, {}, x, y };
  view.origin = view.source + source_to_detector * axis - 255.5 * pitch * (x + y);
  return view;
}

inline std::vector<DetectorDescription> cyberknife()
{
  return { viewAt("detector_a", 45 * kDegree), viewAt("detector_b", -45 * kDegree) };
}

/// Views all around, none of them orthogonal to another; panels differ in nothing but their place.
inline std::vector<DetectorDescription> viewsAround(std::size_t count)
{
  std::vector<DetectorDescription> views;
  for (std::size_t i = 0; i < count; ++i)
  {
    const double share = static_cast<double>(i) / static_cast<double>(count);
    views.push_back(viewAt("detector_" + std::to_string(i), (-50 + 100 * share) * kDegree, 70 * share * kDegree));
  }
  return views;
}

inline std::vector<ProjectionGeometry> geometriesOf(const std::vector<DetectorDescription>& views)
{
  std::vector<ProjectionGeometry> geometries;
  for (const DetectorDescription& view : views)
  {
    geometries.push_back(ProjectionGeometry::fromDescription(view));
  }
  return geometries;
}

/// Size of a view's pixel in a point's distance [mm].
inline double pixelAt(const DetectorDescription& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d normal = view.x_direction.cross(view.y_direction);
  return view.pixel_pitch.x() * normal.dot(point - view.source) / normal.dot(view.origin - view.source);
}

/// Where the ray of a point meets the panel [px], from the description alone.
inline Eigen::Vector2d pixelOf(const DetectorDescription& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d normal = view.x_direction.cross(view.y_direction);
  const double along = normal.dot(view.origin - view.source) / normal.dot(point - view.source);
  const Eigen::Vector3d on_panel = view.source + along * (point - view.source) - view.origin;
  return { on_panel.dot(view.x_direction) / view.pixel_pitch.x(),
           on_panel.dot(view.y_direction) / view.pixel_pitch.y() };
}

/// The patient of the setup files: supine, superior along room x, its origin somewhere.
inline RigidTransform initialPose()
{
  RigidTransform pose = RigidTransform::Identity();
  pose.linear() = Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5).toRotationMatrix();
  pose.translation() = Eigen::Vector3d(550.0, 1.0, 220.0);
  return pose;
}

inline RigidTransform moved(const RigidTransform& pose, const Eigen::Vector3d& translation)
{
  RigidTransform result = pose;
  result.translation() += translation;
  return result;
}

/// What a tracker of the model makes of a local affine map: the nearest warp of its form, by polar decomposition.
inline Eigen::Matrix2d nearestLinear(TrackModel model, const Eigen::Matrix2d& linear)
{
  if (model == TrackModel::TRANSLATION)
  {
    return Eigen::Matrix2d::Identity();
  }
  if (model == TrackModel::AFFINE)
  {
    return linear;
  }
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(linear, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix2d rotation = svd.matrixU() * svd.matrixV().transpose();
  return model == TrackModel::EUCLIDEAN ? rotation : Eigen::Matrix2d(svd.singularValues().mean() * rotation);
}

/// Directions (dx, dy, l11, l12, l21, l22) in which a warp of the model can differ from `linear`, orthonormal.
inline Eigen::MatrixXd freeDirections(TrackModel model, const Eigen::Matrix2d& linear)
{
  Eigen::MatrixXd directions = Eigen::MatrixXd::Zero(6, static_cast<int>(model));
  directions(0, 0) = directions(1, 1) = 1.0;
  const Eigen::Matrix2d turned = Eigen::Rotation2Dd(M_PI / 2) * linear;
  const auto flat = [](const Eigen::Matrix2d& m) { return Eigen::Vector4d(m(0, 0), m(0, 1), m(1, 0), m(1, 1)); };
  if (model == TrackModel::EUCLIDEAN || model == TrackModel::SIMILARITY)
  {
    directions.block<4, 1>(2, 2) = flat(turned).normalized();
  }
  if (model == TrackModel::SIMILARITY)
  {
    directions.block<4, 1>(2, 3) = flat(linear).normalized();
  }
  if (model == TrackModel::AFFINE)
  {
    directions.bottomRightCorner<4, 4>().setIdentity();
  }
  return directions;
}

using Measurements = std::vector<std::optional<ViewMeasurement>>;

/// A treatment whose target stands at `target` (room, mm) in the reference exposure.
struct Scene
{
  std::vector<DetectorDescription> views;
  Eigen::Vector3d target;

  Eigen::Vector3d targetCentre() const { return initialPose().inverse() * target; }

  MotionEstimator estimator(const MotionEstimationOptions& options) const
  {
    return MotionEstimator(options, geometriesOf(views), targetCentre(), TargetShape::isotropic(targetCentre()),
                           initialPose());
  }

  /// The track of one view without any error, of a flat region that faces the source: a pixel's ray is cut with that
  /// plane, the point is moved and projected; the linear part by central differences.
  /// @param motion of the patient since the view was trained, room
  /// @param trained the patient's pose then
  Track exactTrack(std::size_t view, TrackModel model, const RigidTransform& motion,
                   const RigidTransform& trained = initialPose(),
                   const Eigen::Vector2d& region_from_target = Eigen::Vector2d::Zero()) const
  {
    const DetectorDescription& detector = views[view];
    const Eigen::Vector3d centre = trained * targetCentre();
    const auto map = [&](const Eigen::Vector2d& pixel)
    {
      const Eigen::Vector2d offset = pixel.cwiseProduct(detector.pixel_pitch);
      const Eigen::Vector3d ray =
          detector.origin + offset.x() * detector.x_direction + offset.y() * detector.y_direction - detector.source;
      const Eigen::Vector3d to_centre = centre - detector.source;
      const Eigen::Vector3d point = detector.source + ray * to_centre.squaredNorm() / ray.dot(to_centre);
      return pixelOf(detector, motion * point);
    };
    Track track;
    track.model = model;
    track.centre = pixelOf(detector, centre) + region_from_target;
    track.displacement = map(track.centre) - track.centre;
    const double step = 0.05;  // px: rounding and third derivatives both below 1e-10
    Eigen::Matrix2d linear;
    for (int axis = 0; axis < 2; ++axis)
    {
      const Eigen::Vector2d h = step * Eigen::Vector2d::Unit(axis);
      linear.col(axis) = (map(track.centre + h) - map(track.centre - h)) / (2.0 * step);
    }
    track.linear = nearestLinear(model, linear);
    const Eigen::MatrixXd free = freeDirections(model, track.linear);
    Vector6d variance;
    variance << 0.01, 0.01, Eigen::Vector4d::Constant(1e-6);
    track.covariance = free * (free.transpose() * variance.asDiagonal() * free) * free.transpose();
    return track;
  }

  /// Tracks of all views without any error.
  Measurements exactTracks(const RigidTransform& motion, TrackModel model = TrackModel::TRANSLATION) const
  {
    Measurements measurements;
    for (std::size_t i = 0; i < views.size(); ++i)
    {
      measurements.push_back(ViewMeasurement{ initialPose(), exactTrack(i, model, motion) });
    }
    return measurements;
  }
  Measurements exactTracks(const Eigen::Vector3d& translation, TrackModel model = TrackModel::TRANSLATION) const
  {
    return exactTracks(RigidTransform(Eigen::Translation3d(translation)), model);
  }

  /// A rotation about the target's centre, then a translation.
  RigidTransform motion(const Eigen::Vector3d& rotation_vector, const Eigen::Vector3d& translation) const
  {
    Twist twist;
    twist << rotation_vector, translation;
    return motionAbout(target, twist);
  }
};

inline MotionEstimationOptions optionsFor(EstimationMethod method)
{
  MotionEstimationOptions options;
  options.method = method;
  return options;
}

inline MotionEstimate estimateExact(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method)
{
  return scene.estimator(optionsFor(method)).estimate(scene.exactTracks(motion));
}

inline double relativeError(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method)
{
  return (estimateExact(scene, motion, method).translation - motion).norm() / motion.norm();
}

class Random
{
public:
  explicit Random(std::uint64_t seed = 20240611) : generator_(seed) {}

  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(generator_); }
  double normal() { return normal_(generator_); }
  Eigen::Vector3d inCube(double half_edge)
  {
    const double x = uniform(-half_edge, half_edge);
    const double y = uniform(-half_edge, half_edge);
    return { x, y, uniform(-half_edge, half_edge) };
  }
  Eigen::VectorXd normals(int size)
  {
    Eigen::VectorXd result(size);
    for (int i = 0; i < size; ++i)
    {
      result(i) = normal();
    }
    return result;
  }

  /// Adds a draw of the track's covariance and the options' floors, along what the model lets vary.
  void disturb(Track& track, const MotionEstimationOptions& options)
  {
    const Eigen::MatrixXd free = freeDirections(track.model, track.linear);
    Matrix6d covariance = track.covariance;
    covariance.diagonal().head<2>().array() += std::pow(options.floor_sigma / kPixel, 2);
    covariance.diagonal().tail<4>().array() += options.linear_floor_sigma * options.linear_floor_sigma;
    const Eigen::MatrixXd along = free.transpose() * covariance * free;
    const Vector6d change = free * (along.llt().matrixL() * normals(static_cast<int>(free.cols())));
    track.displacement += change.head<2>();
    if (track.model == TrackModel::EUCLIDEAN)
    {
      // Stays a rotation: a step along the tangent (0, -1, 1, 0) / sqrt(2) is an angle.
      const double angle = free.col(2).tail<4>().dot(change.tail<4>()) / std::sqrt(2.0);
      track.linear = Eigen::Rotation2Dd(angle) * track.linear;
      return;
    }
    track.linear += (Eigen::Matrix2d() << change(2), change(3), change(4), change(5)).finished();
  }

private:
  std::mt19937_64 generator_;
  std::normal_distribution<double> normal_;
};

/// That a sum of squares lies within the 95 % bounds of its chi-square distribution.
inline void expectChiSquare(double sum, double degrees_of_freedom, const std::string& what)
{
  const boost::math::chi_squared distribution(degrees_of_freedom);
  EXPECT_GT(sum, boost::math::quantile(distribution, 0.025)) << what;
  EXPECT_LT(sum, boost::math::quantile(distribution, 0.975)) << what;
}
}  // namespace xray_tracking
