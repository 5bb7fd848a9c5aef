#include "scene.h"

#include <boost/math/distributions/chi_squared.hpp>

namespace xray_tracking
{
DetectorDescription viewAt(const std::string& name, double angle, double turn, double source_to_isocentre,
                           double source_to_detector)
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

std::vector<DetectorDescription> cyberknife()
{
  return { viewAt("detector_a", 45 * kDegree), viewAt("detector_b", -45 * kDegree) };
}

std::vector<DetectorDescription> viewsAround(std::size_t count)
{
  std::vector<DetectorDescription> views;
  for (std::size_t i = 0; i < count; ++i)
  {
    const double share = static_cast<double>(i) / static_cast<double>(count);
    views.push_back(viewAt("detector_" + std::to_string(i), (-50 + 100 * share) * kDegree, 70 * share * kDegree));
  }
  return views;
}

std::vector<ProjectionGeometry> geometriesOf(const std::vector<DetectorDescription>& views)
{
  std::vector<ProjectionGeometry> geometries;
  for (const DetectorDescription& view : views)
  {
    geometries.push_back(ProjectionGeometry::fromDescription(view));
  }
  return geometries;
}

double pixelAt(const DetectorDescription& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d normal = view.x_direction.cross(view.y_direction);
  return view.pixel_pitch.x() * normal.dot(point - view.source) / normal.dot(view.origin - view.source);
}

Eigen::Vector2d pixelOf(const DetectorDescription& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d normal = view.x_direction.cross(view.y_direction);
  const double along = normal.dot(view.origin - view.source) / normal.dot(point - view.source);
  const Eigen::Vector3d on_panel = view.source + along * (point - view.source) - view.origin;
  return { on_panel.dot(view.x_direction) / view.pixel_pitch.x(),
           on_panel.dot(view.y_direction) / view.pixel_pitch.y() };
}

RigidTransform initialPose()
{
  RigidTransform pose = RigidTransform::Identity();
  pose.linear() = Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5).toRotationMatrix();
  pose.translation() = Eigen::Vector3d(550.0, 1.0, 220.0);
  return pose;
}

RigidTransform moved(const RigidTransform& pose, const Eigen::Vector3d& translation)
{
  RigidTransform result = pose;
  result.translation() += translation;
  return result;
}

Eigen::Matrix2d nearestLinear(TrackModel model, const Eigen::Matrix2d& linear)
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

Eigen::MatrixXd freeDirections(TrackModel model, const Eigen::Matrix2d& linear)
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

Eigen::Vector3d Scene::targetCentre() const
{
  return initialPose().inverse() * target;
}

MotionEstimator Scene::estimator(const MotionEstimationOptions& options) const
{
  return MotionEstimator(options, geometriesOf(views), targetCentre(), TargetShape::isotropic(targetCentre()),
                         initialPose());
}

Track Scene::exactTrack(std::size_t view, TrackModel model, const RigidTransform& motion, const RigidTransform& trained,
                        const Eigen::Vector2d& region_from_target) const
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

Measurements Scene::exactTracks(const RigidTransform& motion, TrackModel model) const
{
  Measurements measurements;
  for (std::size_t i = 0; i < views.size(); ++i)
  {
    measurements.push_back(ViewMeasurement{ initialPose(), exactTrack(i, model, motion) });
  }
  return measurements;
}

Measurements Scene::exactTracks(const Eigen::Vector3d& translation, TrackModel model) const
{
  return exactTracks(RigidTransform(Eigen::Translation3d(translation)), model);
}

RigidTransform Scene::motion(const Eigen::Vector3d& rotation_vector, const Eigen::Vector3d& translation) const
{
  Twist twist;
  twist << rotation_vector, translation;
  return motionAbout(target, twist);
}

MotionEstimationOptions optionsFor(EstimationMethod method)
{
  MotionEstimationOptions options;
  options.method = method;
  return options;
}

MotionEstimate estimateExact(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method)
{
  return scene.estimator(optionsFor(method)).estimate(scene.exactTracks(motion));
}

double relativeError(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method)
{
  return (estimateExact(scene, motion, method).translation - motion).norm() / motion.norm();
}

Eigen::Vector3d Random::inCube(double half_edge)
{
  const double x = uniform(-half_edge, half_edge);
  const double y = uniform(-half_edge, half_edge);
  return { x, y, uniform(-half_edge, half_edge) };
}

Eigen::VectorXd Random::normals(int size)
{
  Eigen::VectorXd result(size);
  for (int i = 0; i < size; ++i)
  {
    result(i) = normal();
  }
  return result;
}

void Random::disturb(Track& track, const MotionEstimationOptions& options)
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

void expectChiSquare(double sum, double degrees_of_freedom, const std::string& what)
{
  const boost::math::chi_squared distribution(degrees_of_freedom);
  EXPECT_GT(sum, boost::math::quantile(distribution, 0.025)) << what;
  EXPECT_LT(sum, boost::math::quantile(distribution, 0.975)) << what;
}
}  // namespace xray_tracking
