#include "xray_tracking_core/geometry/projection_geometry.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

#include <Eigen/Dense>

namespace xray_tracking
{
namespace
{
constexpr double kDirectionTolerance = 1e-4;
constexpr double kMinSourceToDetector = 1.0;  // mm
/// More than any panel has; images of a mistyped size would not fit the memory.
constexpr int kMaxImageSize = 16384;

template <typename Value>
[[noreturn]] void reject(const std::string& detector, const std::string& field, const Value& value,
                         const std::string& expected)
{
  std::ostringstream message;
  message << "detector '" << detector << "': " << field << " [" << value << "]: expected " << expected;
  throw std::invalid_argument(message.str());
}

template <typename Vector>
void checkFinite(const std::string& detector, const std::string& field, const Vector& value)
{
  if (!value.allFinite())
  {
    reject(detector, field, value.transpose(), "finite numbers");
  }
}

template <typename Vector>
void checkPositive(const std::string& detector, const std::string& field, const Vector& value)
{
  checkFinite(detector, field, value);
  if (!(value.minCoeff() > 0))
  {
    reject(detector, field, value.transpose(), "positive numbers");
  }
}

void checkUnit(const std::string& detector, const std::string& field, const Eigen::Vector3d& direction)
{
  checkFinite(detector, field, direction);
  if (std::abs(direction.norm() - 1.0) > kDirectionTolerance)
  {
    reject(detector, field, direction.transpose(), "a direction of unit norm to 1e-4");
  }
}

/// What mends a panel whose columns and rows are as seen from behind.
std::string turned(const DetectorDescription& description)
{
  const Eigen::IOFormat list(9, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  const double height = (description.image_size.y() - 1) * description.pixel_pitch.y();
  std::ostringstream text;
  text << ". Its images are mirrored: turn them upside down, with origin_mm: "
       << (description.origin + height * description.y_direction).format(list)
       << ", y_direction: " << (-description.y_direction).eval().format(list)
       << " (import_geometry does as much for columns). Or are source and panel swapped?";
  return text.str();
}
}  // namespace

bool isDetectorName(const std::string& name)
{
  return !name.empty() && std::isalpha(static_cast<unsigned char>(name.front())) &&
         std::all_of(name.begin(), name.end(),
                     [](unsigned char c) { return c < 128 && (std::isalnum(c) || c == '_'); });
}

ProjectionGeometry ProjectionGeometry::fromDescription(const DetectorDescription& description)
{
  const std::string& name = description.name;
  if (!isDetectorName(name))
  {
    reject(name, "name", name, "a letter followed by letters, digits and underscores");
  }
  if (description.image_size.minCoeff() < 1 || description.image_size.maxCoeff() > kMaxImageSize)
  {
    reject(name, "image_size", description.image_size.transpose(), "positive numbers up to 16384");
  }
  checkPositive(name, "pixel_pitch_mm", description.pixel_pitch);
  checkFinite(name, "source_mm", description.source);
  checkFinite(name, "origin_mm", description.origin);
  checkUnit(name, "x_direction", description.x_direction);
  checkUnit(name, "y_direction", description.y_direction);
  const double cosine = description.x_direction.dot(description.y_direction);
  if (std::abs(cosine) > kDirectionTolerance)
  {
    reject(name, "y_direction", description.y_direction.transpose(),
           "a right angle to x_direction to 1e-4, the cosine is " + std::to_string(cosine));
  }

  ProjectionGeometry geometry;
  geometry.description_ = description;
  // Sum and difference of two unit vectors are at right angles: shares the correction evenly between the axes.
  Eigen::Vector3d& x = geometry.description_.x_direction;
  Eigen::Vector3d& y = geometry.description_.y_direction;
  const Eigen::Vector3d sum = (x.normalized() + y.normalized()).normalized();
  const Eigen::Vector3d difference = (x.normalized() - y.normalized()).normalized();
  x = (sum + difference).normalized();
  y = (sum - difference).normalized();

  Eigen::Matrix3d axes;
  axes << x, y, x.cross(y);
  geometry.room_from_optical_ = RigidTransform::Identity();
  geometry.room_from_optical_.linear() = axes;
  geometry.room_from_optical_.translation() = description.source;
  geometry.optical_from_room_ = geometry.room_from_optical_.inverse();

  const Eigen::Vector3d origin = geometry.optical_from_room_ * description.origin;
  geometry.source_to_detector_ = origin.z();
  if (!(origin.z() >= kMinSourceToDetector))
  {
    reject(name, "source_mm", description.source.transpose(),
           "a point at least 1 mm from the panel on the side that x_direction cross y_direction points away from, is " +
               std::to_string(origin.z()) + " mm" + (origin.z() < -kMinSourceToDetector ? turned(description) : ""));
  }
  geometry.foot_ = -origin.head<2>().cwiseQuotient(description.pixel_pitch);
  geometry.focal_length_ = origin.z() * description.pixel_pitch.cwiseInverse();
  // Numbers that are finite one by one may overflow together.
  checkPositive(name, "focal length (fx, fy)", geometry.focal_length_);
  checkFinite(name, "foot (cx, cy)", geometry.foot_);
  return geometry;
}

ProjectionGeometry ProjectionGeometry::fromIntrinsics(const std::string& name, const Eigen::Vector2i& image_size,
                                                      const Eigen::Vector2d& focal_length, const Eigen::Vector2d& foot,
                                                      const RigidTransform& room_from_optical,
                                                      double source_to_detector)
{
  checkPositive(name, "focal length (fx, fy)", focal_length);
  checkFinite(name, "foot (cx, cy)", foot);
  if (!isRigid(room_from_optical))
  {
    reject(name, "pose of the optical frame", room_from_optical.matrix(), "a finite rigid transform");
  }
  if (!(source_to_detector >= kMinSourceToDetector) || !std::isfinite(source_to_detector))
  {
    reject(name, "source to detector distance", source_to_detector, "1 mm or more");
  }
  DetectorDescription description;
  description.name = name;
  description.image_size = image_size;
  description.pixel_pitch = source_to_detector * focal_length.cwiseInverse();
  description.source = room_from_optical.translation();
  const Eigen::Vector2d corner = -foot.cwiseProduct(description.pixel_pitch);
  description.origin = room_from_optical * Eigen::Vector3d(corner.x(), corner.y(), source_to_detector);
  description.x_direction = room_from_optical.linear().col(0);
  description.y_direction = room_from_optical.linear().col(1);
  return fromDescription(description);
}

double ProjectionGeometry::depth(const Eigen::Vector3d& room_point) const
{
  return (optical_from_room_ * room_point).z();
}

double ProjectionGeometry::magnification(const Eigen::Vector3d& room_point) const
{
  return source_to_detector_ / depth(room_point);
}

Eigen::Vector2d ProjectionGeometry::project(const Eigen::Vector3d& room_point) const
{
  const Eigen::Vector3d p = optical_from_room_ * room_point;
  if (!(p.z() > 0.0))
  {
    return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  return focal_length_.cwiseProduct(p.head<2>() / p.z()) + foot_;
}

Eigen::Matrix<double, 2, 3> ProjectionGeometry::projectionJacobian(const Eigen::Vector3d& room_point) const
{
  const Eigen::Vector3d p = optical_from_room_ * room_point;
  if (!(p.z() > 0.0))
  {
    return Eigen::Matrix<double, 2, 3>::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  Eigen::Matrix<double, 2, 3> by_optical;
  by_optical << 1.0, 0.0, -p.x() / p.z(),  //
      0.0, 1.0, -p.y() / p.z();
  return (focal_length_ / p.z()).asDiagonal() * by_optical * optical_from_room_.linear();
}

Eigen::Vector3d ProjectionGeometry::pixelPosition(const Eigen::Vector2d& pixel) const
{
  const Eigen::Vector2d offset = pixel.cwiseProduct(description_.pixel_pitch);
  return description_.origin + offset.x() * description_.x_direction + offset.y() * description_.y_direction;
}

Ray ProjectionGeometry::backProject(const Eigen::Vector2d& pixel) const
{
  return { description_.source, (pixelPosition(pixel) - description_.source).normalized() };
}

Eigen::Vector3d triangulate(const std::vector<ProjectionGeometry>& views, const std::vector<Eigen::Vector2d>& pixels)
{
  if (views.size() < 2 || views.size() != pixels.size())
  {
    throw std::invalid_argument("triangulate: " + std::to_string(views.size()) + " views and " +
                                std::to_string(pixels.size()) + " pixels: expected two or more views, one pixel each");
  }

  // Start: the point nearest to all rays.
  Eigen::Matrix3d normal_matrix = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right_side = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < views.size(); ++i)
  {
    checkFinite(views[i].name(), "pixel", pixels[i]);
    const Ray ray = views[i].backProject(pixels[i]);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    normal_matrix += across;
    right_side += across * ray.source;
  }
  // The smallest eigenvalue is about half the square of the angle between two rays: 1e-8 is 0.008 degrees.
  if (Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(normal_matrix).eigenvalues().minCoeff() < 1e-8)
  {
    throw std::invalid_argument("triangulate: the rays of " + views.front().name() + ", " + views[1].name() +
                                " ... are parallel: expected views from different directions");
  }
  Eigen::Vector3d point = normal_matrix.ldlt().solve(right_side);

  // Gauss-Newton; from this start it settles in two or three steps.
  constexpr int kMaxSteps = 20;
  constexpr double kSmallStep = 1e-3;  // mm
  Eigen::Vector3d change;
  for (int step = 0; step < kMaxSteps; ++step)
  {
    normal_matrix.setZero();
    right_side.setZero();
    for (std::size_t i = 0; i < views.size(); ++i)
    {
      if (!(views[i].depth(point) > 0.0))
      {
        throw std::invalid_argument("triangulate: the rays do not meet in front of the source of " + views[i].name());
      }
      const Eigen::Matrix<double, 2, 3> jacobian = views[i].projectionJacobian(point);
      normal_matrix += jacobian.transpose() * jacobian;
      right_side += jacobian.transpose() * (pixels[i] - views[i].project(point));
    }
    change = normal_matrix.ldlt().solve(right_side);
    point += change;
    if (change.norm() < 1e-9)
    {
      break;
    }
  }
  if (!(change.norm() < kSmallStep))
  {
    throw std::invalid_argument("triangulate: found no point, the rays of " + views.front().name() + ", " +
                                views[1].name() + " ... miss each other too widely");
  }
  return point;
}
}  // namespace xray_tracking
