#include "xray_tracking_core/volume/solid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

namespace xray_tracking
{
namespace
{
constexpr RaySegment kMissed{ 0.0, 0.0 };

/// Shortens the segment to where origin + t * slope <= limit.
void clip(double origin, double slope, double limit, RaySegment& segment)
{
  const double room = limit - origin;
  if (slope > 0.0)
  {
    segment.exit = std::min(segment.exit, room / slope);
  }
  else if (slope < 0.0)
  {
    segment.enter = std::max(segment.enter, room / slope);
  }
  else if (room < 0.0)
  {
    segment = kMissed;
  }
}
}  // namespace

Solid::Solid(Shape shape, const RigidTransform& patient_from_solid, const Eigen::Vector3d& half_axes,
             const Materials& added)
  : shape_(shape), centre_(patient_from_solid.translation()), added_(added)
{
  if (!half_axes.allFinite() || !(half_axes.array() > 0.0).all())
  {
    std::ostringstream message;
    message << "half_axes of a solid are (" << half_axes.transpose() << ") mm, expected three positive numbers";
    throw std::invalid_argument(message.str());
  }
  patient_from_unit_ = patient_from_solid.linear() * half_axes.asDiagonal();
  unit_from_patient_ = half_axes.cwiseInverse().asDiagonal() * patient_from_solid.linear().transpose();
  switch (shape)
  {
    case Shape::ELLIPSOID:
      bounding_radius_ = half_axes.maxCoeff();
      break;
    case Shape::CYLINDER:
      bounding_radius_ = std::hypot(half_axes.head<2>().maxCoeff(), half_axes.z());
      break;
    case Shape::BOX:
      bounding_radius_ = half_axes.norm();
      break;
  }
}

Solid& Solid::cutBy(const Eigen::Vector3d& normal, double offset)
{
  cuts_.push_back({ normal, offset });
  return *this;
}

RaySegment Solid::intersect(const Ray& ray) const
{
  return SolidFromSource(*this, ray.source).intersect(ray.direction);
}

bool Solid::contains(const Eigen::Vector3d& point) const
{
  if ((point - centre_).squaredNorm() > bounding_radius_ * bounding_radius_)
  {
    return false;
  }
  const Eigen::Vector3d unit = unit_from_patient_ * (point - centre_);
  bool inside = false;
  switch (shape_)
  {
    case Shape::ELLIPSOID:
      inside = unit.squaredNorm() <= 1.0;
      break;
    case Shape::CYLINDER:
      inside = unit.head<2>().squaredNorm() <= 1.0 && std::abs(unit.z()) <= 1.0;
      break;
    case Shape::BOX:
      inside = unit.cwiseAbs().maxCoeff() <= 1.0;
      break;
  }
  return inside && std::all_of(cuts_.begin(), cuts_.end(),
                               [&point](const HalfSpace& cut) { return cut.normal.dot(point) <= cut.offset; });
}

Eigen::AlignedBox3d Solid::boundingBox() const
{
  Eigen::Vector3d half = Eigen::Vector3d::Zero();
  switch (shape_)
  {
    case Shape::ELLIPSOID:
      half = patient_from_unit_.rowwise().norm();
      break;
    case Shape::CYLINDER:
      half = patient_from_unit_.leftCols<2>().rowwise().norm() + patient_from_unit_.col(2).cwiseAbs();
      break;
    case Shape::BOX:
      half = patient_from_unit_.cwiseAbs().rowwise().sum();
      break;
  }
  return { centre_ - half, centre_ + half };
}

std::array<Eigen::Vector3d, 8> Solid::corners() const
{
  std::array<Eigen::Vector3d, 8> corners;
  for (int i = 0; i < 8; ++i)
  {
    corners[i] = centre_ + patient_from_unit_ * Eigen::Vector3d(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
  }
  return corners;
}

SolidFromSource::SolidFromSource(const Solid& solid, const Eigen::Vector3d& source)
  : solid_(&solid),
    source_(source),
    unit_source_(solid.unit_from_patient_ * (source - solid.centre_)),
    quadric_at_source_(
        (solid.shape_ == Solid::Shape::CYLINDER ? unit_source_.head<2>().squaredNorm() : unit_source_.squaredNorm()) -
        1.0)
{
}

inline RaySegment SolidFromSource::intersect(const Eigen::Vector3d& direction,
                                             const Eigen::Vector3d& unit_direction) const
{
  RaySegment segment{ 0.0, std::numeric_limits<double>::infinity() };
  if (solid_->shape_ != Solid::Shape::BOX)
  {
    // |o + t d|^2 = 1, in three dimensions for the ball and in two for the cylinder.
    const bool cylinder = solid_->shape_ == Solid::Shape::CYLINDER;
    const double dz = cylinder ? 0.0 : unit_direction.z();
    const double a = unit_direction.head<2>().squaredNorm() + dz * dz;
    const double b = unit_source_.head<2>().dot(unit_direction.head<2>()) + unit_source_.z() * dz;
    const double discriminant = b * b - a * quadric_at_source_;
    if (a > 0.0)
    {
      if (discriminant <= 0.0)
      {
        return kMissed;
      }
      const double root = std::sqrt(discriminant);
      segment.enter = std::max(0.0, (-b - root) / a);
      segment.exit = (-b + root) / a;
    }
    else if (quadric_at_source_ > 0.0)
    {
      return kMissed;
    }
    if (cylinder)
    {
      clip(unit_source_.z(), unit_direction.z(), 1.0, segment);
      clip(-unit_source_.z(), -unit_direction.z(), 1.0, segment);
    }
  }
  else
  {
    for (int i = 0; i < 3; ++i)
    {
      clip(unit_source_[i], unit_direction[i], 1.0, segment);
      clip(-unit_source_[i], -unit_direction[i], 1.0, segment);
    }
  }
  for (const Solid::HalfSpace& cut : solid_->cuts_)
  {
    clip(cut.normal.dot(source_), cut.normal.dot(direction), cut.offset, segment);
  }
  return segment.exit > segment.enter ? segment : kMissed;
}

RaySegment SolidFromSource::intersect(const Eigen::Vector3d& direction) const
{
  return intersect(direction, solid_->unit_from_patient_ * direction);
}

void SolidFromSource::addRow(const Eigen::Vector3d& first, const Eigen::Vector3d& step, int count,
                             Materials* sums) const
{
  const Eigen::Vector3d unit_first = solid_->unit_from_patient_ * first;
  const Eigen::Vector3d unit_step = solid_->unit_from_patient_ * step;
  const Materials added = solid_->added_;
  for (int i = 0; i < count; ++i)
  {
    const double length = intersect(first + i * step, unit_first + i * unit_step).length();
    sums[i].soft += length * added.soft;
    sums[i].bone += length * added.bone;
  }
}
}  // namespace xray_tracking
