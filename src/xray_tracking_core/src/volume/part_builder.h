#pragma once

#include <vector>

#include "xray_tracking_core/volume/solid.h"

namespace xray_tracking
{
constexpr double kMuscleHu = 50.0;

/// Adds solids to a list, given in the axes of one part of the body (a vertebra, the jaw). A solid states its own HU
/// and those of what surrounds it, and adds the difference.
class PartBuilder
{
public:
  PartBuilder(std::vector<Solid>& solids, const RigidTransform& patient_from_part)
    : solids_(solids), patient_from_part_(patient_from_part)
  {
  }

  /// Along the part's axes, but for a turn about its x axis [rad].
  PartBuilder& add(Solid::Shape shape, const Eigen::Vector3d& centre, const Eigen::Vector3d& half_axes, double hu,
                   double surrounding_hu = kMuscleHu, double turn = 0.0)
  {
    RigidTransform part_from_solid(Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitX()));
    part_from_solid.pretranslate(centre);
    return place(shape, part_from_solid, half_axes, hu, surrounding_hu);
  }

  /// From one point to another; across this line, half as wide and half as high (towards the part's z) as given.
  PartBuilder& rod(Solid::Shape shape, const Eigen::Vector3d& from, const Eigen::Vector3d& to, double half_width,
                   double half_height, double hu, double surrounding_hu = kMuscleHu)
  {
    const Eigen::Vector3d along = to - from;
    RigidTransform part_from_solid = RigidTransform::Identity();
    part_from_solid.translation() = 0.5 * (from + to);
    Eigen::Matrix3d axes;
    axes.col(2) = along.normalized();
    axes.col(0) = Eigen::Vector3d::UnitZ().cross(axes.col(2)).normalized();
    axes.col(1) = axes.col(2).cross(axes.col(0));
    part_from_solid.linear() = axes;
    return place(shape, part_from_solid, { half_width, half_height, 0.5 * along.norm() }, hu, surrounding_hu);
  }

  /// Takes from the solid added last what lies on the plane's side that the normal points to.
  PartBuilder& cut(const Eigen::Vector3d& normal, const Eigen::Vector3d& point_in_plane)
  {
    const Eigen::Vector3d patient_normal = patient_from_part_.linear() * normal;
    solids_.back().cutBy(patient_normal, patient_normal.dot(patient_from_part_ * point_in_plane));
    return *this;
  }

private:
  PartBuilder& place(Solid::Shape shape, const RigidTransform& part_from_solid, const Eigen::Vector3d& half_axes,
                     double hu, double surrounding_hu)
  {
    const Materials inside = materialsFromHu(hu);
    const Materials outside = materialsFromHu(surrounding_hu);
    solids_.emplace_back(shape, patient_from_part_ * part_from_solid, half_axes,
                         Materials{ inside.soft - outside.soft, inside.bone - outside.bone });
    return *this;
  }

  std::vector<Solid>& solids_;
  RigidTransform patient_from_part_;
};
}  // namespace xray_tracking
