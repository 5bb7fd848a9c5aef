#pragma once

#include <array>
#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
/// The part of a ray inside a convex solid: distances from the ray's source [mm], never negative; empty if
/// `exit <= enter`.
struct RaySegment
{
  double enter = 0.0;
  double exit = 0.0;

  double length() const { return exit > enter ? exit - enter : 0.0; }
};

/// A convex solid with closed-form ray intersection: an ellipsoid, an elliptic cylinder or a box, cut by any number of
/// half-spaces, with the amounts of material that it adds to what it lies in (negative: takes away).
class Solid
{
public:
  enum class Shape
  {
    ELLIPSOID,  ///< half axes x, y, z
    CYLINDER,   ///< elliptic in x and y, capped at +-z
    BOX         ///< half edges x, y, z
  };

  /// @param patient_from_solid pose of the solid's own axes; @param half_axes [mm], all > 0; @param added materials
  /// @throws std::invalid_argument for a half axis that is not positive and finite
  Solid(Shape shape, const RigidTransform& patient_from_solid, const Eigen::Vector3d& half_axes,
        const Materials& added);

  /// Keeps only the points with normal . p <= offset (patient frame, mm); the normal need not be of unit length.
  Solid& cutBy(const Eigen::Vector3d& normal, double offset);

  const Materials& added() const { return added_; }
  /// Where a ray (patient frame) runs inside.
  RaySegment intersect(const Ray& ray) const;
  /// Whether a point (patient frame) is inside.
  bool contains(const Eigen::Vector3d& point) const;
  /// A sphere around the uncut solid: centre in the patient frame and radius [mm].
  const Eigen::Vector3d& centre() const { return centre_; }
  double boundingRadius() const { return bounding_radius_; }
  /// Axis-aligned box around the uncut solid, patient frame [mm].
  Eigen::AlignedBox3d boundingBox() const;
  /// Corners of the box along the solid's own axes around the uncut solid, patient frame [mm].
  std::array<Eigen::Vector3d, 8> corners() const;

private:
  friend class SolidFromSource;

  struct HalfSpace
  {
    Eigen::Vector3d normal;
    double offset;
  };

  Shape shape_;
  Eigen::Matrix3d unit_from_patient_;  ///< rotates and scales into the unit solid
  Eigen::Vector3d centre_;
  Eigen::Matrix3d patient_from_unit_;
  double bounding_radius_;
  Materials added_;
  std::vector<HalfSpace> cuts_;
};

/// A solid seen from one focal spot: holds what all of the spot's rays share. Refers to the solid, which must outlive
/// it unchanged.
class SolidFromSource
{
public:
  /// @param source patient frame [mm]
  SolidFromSource(const Solid& solid, const Eigen::Vector3d& source);

  /// Where the ray along `direction` (patient frame, not zero, of any length) runs inside, in multiples of
  /// `direction`'s length.
  RaySegment intersect(const Eigen::Vector3d& direction) const;
  /// Adds to sums[i], for i = 0 .. count - 1, the solid's materials along the direction first + i * step, as lengths in
  /// multiples of that direction's. For rows of an image.
  void addRow(const Eigen::Vector3d& first, const Eigen::Vector3d& step, int count, Materials* sums) const;

private:
  RaySegment intersect(const Eigen::Vector3d& direction, const Eigen::Vector3d& unit_direction) const;

  const Solid* solid_;
  Eigen::Vector3d source_;
  Eigen::Vector3d unit_source_;
  double quadric_at_source_;  ///< of the unit ball or unit cylinder: negative inside
};
}  // namespace xray_tracking
