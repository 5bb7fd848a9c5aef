#pragma once

#include <cmath>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>

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
DetectorDescription viewAt(const std::string& name, double angle, double turn = 0.0,
                           double source_to_isocentre = kSourceToIsocentre,
                           double source_to_detector = kSourceToDetector);

std::vector<DetectorDescription> cyberknife();

/// Views all around, none of them orthogonal to another; panels differ in nothing but their place.
std::vector<DetectorDescription> viewsAround(std::size_t count);

std::vector<ProjectionGeometry> geometriesOf(const std::vector<DetectorDescription>& views);

/// Size of a view's pixel in a point's distance [mm].
double pixelAt(const DetectorDescription& view, const Eigen::Vector3d& point);

/// Where the ray of a point meets the panel [px], from the description alone.
Eigen::Vector2d pixelOf(const DetectorDescription& view, const Eigen::Vector3d& point);

/// The patient of the setup files: supine, superior along room x, its origin somewhere.
RigidTransform initialPose();

RigidTransform moved(const RigidTransform& pose, const Eigen::Vector3d& translation);

/// What a tracker of the model makes of a local affine map: the nearest warp of its form, by polar decomposition.
Eigen::Matrix2d nearestLinear(TrackModel model, const Eigen::Matrix2d& linear);

/// Directions (dx, dy, l11, l12, l21, l22) in which a warp of the model can differ from `linear`, orthonormal.
Eigen::MatrixXd freeDirections(TrackModel model, const Eigen::Matrix2d& linear);

using Measurements = std::vector<std::optional<ViewMeasurement>>;

/// A treatment whose target stands at `target` (room, mm) in the reference exposure.
struct Scene
{
  std::vector<DetectorDescription> views;
  Eigen::Vector3d target;

  Eigen::Vector3d targetCentre() const;

  MotionEstimator estimator(const MotionEstimationOptions& options) const;

  /// The track of one view without any error, of a flat region that faces the source: a pixel's ray is cut with that
  /// plane, the point is moved and projected; the linear part by central differences.
  /// @param motion of the patient since the view was trained, room
  /// @param trained the patient's pose then
  Track exactTrack(std::size_t view, TrackModel model, const RigidTransform& motion,
                   const RigidTransform& trained = initialPose(),
                   const Eigen::Vector2d& region_from_target = Eigen::Vector2d::Zero()) const;

  /// Tracks of all views without any error.
  Measurements exactTracks(const RigidTransform& motion, TrackModel model = TrackModel::TRANSLATION) const;
  Measurements exactTracks(const Eigen::Vector3d& translation, TrackModel model = TrackModel::TRANSLATION) const;

  /// A rotation about the target's centre, then a translation.
  RigidTransform motion(const Eigen::Vector3d& rotation_vector, const Eigen::Vector3d& translation) const;
};

MotionEstimationOptions optionsFor(EstimationMethod method);

MotionEstimate estimateExact(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method);

double relativeError(const Scene& scene, const Eigen::Vector3d& motion, EstimationMethod method);

class Random
{
public:
  explicit Random(std::uint64_t seed = 20240611) : generator_(seed) {}

  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(generator_); }
  double normal() { return normal_(generator_); }
  Eigen::Vector3d inCube(double half_edge);
  Eigen::VectorXd normals(int size);

  /// Adds a draw of the track's covariance and the options' floors, along what the model lets vary.
  void disturb(Track& track, const MotionEstimationOptions& options);

private:
  std::mt19937_64 generator_;
  std::normal_distribution<double> normal_;
};

/// That a sum of squares lies within the 95 % bounds of its chi-square distribution.
void expectChiSquare(double sum, double degrees_of_freedom, const std::string& what);
}  // namespace xray_tracking
