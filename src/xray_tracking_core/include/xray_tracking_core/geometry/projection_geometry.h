#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// A ray of a projection, in mm: from the focal spot towards a detector pixel; `direction` has unit norm.
struct Ray
{
  Eigen::Vector3d source;
  Eigen::Vector3d direction;
};

/// How the focal spot and a flat detector stand in the room (docs/frames.md, "Detectors"); the fields are as in a
/// sequence file's `detectors` entry.
struct DetectorDescription
{
  std::string name;             ///< for messages and topic namespaces, see isDetectorName()
  Eigen::Vector2i image_size;   ///< columns, rows [px]
  Eigen::Vector2d pixel_pitch;  ///< along columns, along rows [mm]
  Eigen::Vector3d source;       ///< focal spot, room [mm]
  Eigen::Vector3d origin;       ///< centre of pixel (0, 0), room [mm]
  Eigen::Vector3d x_direction;  ///< along growing columns, room, unit
  Eigen::Vector3d y_direction;  ///< along growing rows, room, unit
};

/// Whether it is a letter followed by letters, digits and underscores, of ASCII all.
bool isDetectorName(const std::string& name);

/// The perspective projection of one X-ray source onto one flat panel, which may be off-centre and tilted.
///
/// Optical frame (REP-104): origin at the focal spot, x along columns, y along rows, z = x cross y, from the source to
/// the panel. Pixel coordinates (u, v) are continuous; whole numbers are pixel centres. Immutable.
class ProjectionGeometry
{
public:
  /// @throws std::invalid_argument naming the detector, the field, its value and what was expected: a name by
  /// isDetectorName(); image sizes 1 to 16384; pitches positive; directions of unit norm and
  /// at right angles to 1e-4 (then re-orthonormalised); the source off the panel on its negative z side by at least 1
  /// mm; everything finite.
  static ProjectionGeometry fromDescription(const DetectorDescription& description);

  /// From a pinhole camera (sensor_msgs/CameraInfo's K) and its pose. K fixes the projection but not the panel's
  /// distance, which `source_to_detector` [mm] gives; projections do not depend on it, pixelPitch() and origin() do.
  /// @param focal_length fx, fy [px]; @param foot cx, cy [px].
  /// @throws std::invalid_argument as above.
  static ProjectionGeometry fromIntrinsics(const std::string& name, const Eigen::Vector2i& image_size,
                                           const Eigen::Vector2d& focal_length, const Eigen::Vector2d& foot,
                                           const RigidTransform& room_from_optical, double source_to_detector);

  const std::string& name() const { return description_.name; }
  const DetectorDescription& description() const { return description_; }
  const Eigen::Vector2i& imageSize() const { return description_.image_size; }
  const Eigen::Vector2d& pixelPitch() const { return description_.pixel_pitch; }
  const Eigen::Vector3d& source() const { return description_.source; }
  const Eigen::Vector3d& origin() const { return description_.origin; }
  const Eigen::Vector3d& xDirection() const { return description_.x_direction; }
  const Eigen::Vector3d& yDirection() const { return description_.y_direction; }

  /// Length of the perpendicular from the source to the panel, SDD [mm] (the paper's f).
  double sourceToDetector() const { return source_to_detector_; }
  /// The perpendicular's foot (cx, cy) [px].
  const Eigen::Vector2d& foot() const { return foot_; }
  /// (fx, fy) = SDD / pitch [px].
  const Eigen::Vector2d& focalLength() const { return focal_length_; }
  const RigidTransform& roomFromOptical() const { return room_from_optical_; }

  /// Distance of a room point from the source along the panel's normal [mm]; positive in front of the source.
  double depth(const Eigen::Vector3d& room_point) const;
  /// SDD / depth: how much larger the point's neighbourhood appears on the panel. Its inverse is the paper's c, eq.
  /// (3).
  double magnification(const Eigen::Vector3d& room_point) const;

  /// Pixel (u, v) of a room point [mm]; NaN if the point is not in front of the source.
  Eigen::Vector2d project(const Eigen::Vector3d& room_point) const;
  /// Derivative of project() with respect to the room point [px / mm].
  Eigen::Matrix<double, 2, 3> projectionJacobian(const Eigen::Vector3d& room_point) const;

  /// Room position of a pixel on the panel [mm].
  Eigen::Vector3d pixelPosition(const Eigen::Vector2d& pixel) const;
  /// Back-projection of a pixel: its ray in the room.
  Ray backProject(const Eigen::Vector2d& pixel) const;

private:
  ProjectionGeometry() = default;

  DetectorDescription description_;
  RigidTransform room_from_optical_;
  RigidTransform optical_from_room_;
  Eigen::Vector2d foot_;
  Eigen::Vector2d focal_length_;
  double source_to_detector_;
};

/// The room point [mm] nearest in least squares to where the given pixels are seen, one pixel a view; iterated on the
/// reprojection error [px].
/// @throws std::invalid_argument for fewer than two views, a number of pixels other than that of the views, a pixel
/// that is not finite, parallel rays (to 0.01 degrees), or rays that meet behind a source or miss each other too widely
Eigen::Vector3d triangulate(const std::vector<ProjectionGeometry>& views, const std::vector<Eigen::Vector2d>& pixels);
}  // namespace xray_tracking
