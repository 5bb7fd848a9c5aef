#include "xray_tracking_conversions/conversions.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

namespace xray_tracking
{
namespace
{
template <typename Value>
[[noreturn]] void refuse(const std::string& field, const Value& value, const std::string& expected)
{
  std::ostringstream message;
  message << field << " is " << value << ", expected " << expected;
  throw std::invalid_argument(message.str());
}

/// A vector or point message to mm. REP-117: NaN stands for a missing value, which no core type has.
template <typename Message>
Eigen::Vector3d millimetresFromMsg(const std::string& field, const Message& message)
{
  const Eigen::Vector3d metres(message.x, message.y, message.z);
  if (!metres.allFinite())
    refuse(field, metres.transpose(), "finite numbers [m]");
  return kMillimetresPerMetre * metres;
}

RigidTransform rigidFromMsg(const std::string& translation_field, const Eigen::Vector3d& translation,
                            const std::string& rotation_field, const geometry_msgs::Quaternion& rotation)
{
  try
  {
    return makeRigidTransform(translation, Eigen::Quaterniond(rotation.w, rotation.x, rotation.y, rotation.z));
  }
  catch (const std::invalid_argument& error)
  {
    throw std::invalid_argument(translation_field + ", " + rotation_field + ": " + error.what());
  }
}

template <typename Message>
Message xyzMsg(const Eigen::Vector3d& millimetres)
{
  Message message;
  message.x = millimetres.x() / kMillimetresPerMetre;
  message.y = millimetres.y() / kMillimetresPerMetre;
  message.z = millimetres.z() / kMillimetresPerMetre;
  return message;
}

/// Factors of (translation, rotation vector).
Eigen::Matrix<double, 6, 1> poseUnit(double length)
{
  Eigen::Matrix<double, 6, 1> unit = Eigen::Matrix<double, 6, 1>::Ones();
  unit.head<3>() *= length;
  return unit;
}

geometry_msgs::Quaternion quaternionMsg(const RigidTransform& transform)
{
  const Eigen::Quaterniond rotation = Eigen::Quaterniond(transform.linear()).normalized();
  geometry_msgs::Quaternion message;
  message.x = rotation.x();
  message.y = rotation.y();
  message.z = rotation.z();
  message.w = rotation.w();
  return message;
}

bool allZero(const double* begin, const double* end)
{
  return std::all_of(begin, end, [](double value) { return value == 0.0; });
}

void requireEntry(const std::string& matrix, std::size_t index, double value, double expected)
{
  // Written so that NaN fails too.
  if (!(std::abs(value - expected) <= 1e-9 * std::max(1.0, std::abs(expected))))
    refuse("camera_info." + matrix + "[" + std::to_string(index) + "]", value, std::to_string(expected));
}

void requirePinhole(const sensor_msgs::CameraInfo& info)
{
  for (const std::size_t i : { 0, 2, 4, 5 })
    if (!std::isfinite(info.K[i]))
      refuse("camera_info.K[" + std::to_string(i) + "]", info.K[i], "a finite number [px]");
  for (const std::size_t i : { 0, 4 })
    if (!(info.K[i] > 0.0))
      refuse("camera_info.K[" + std::to_string(i) + "]", info.K[i], "a focal length > 0 px");
  for (const std::size_t i : { 1, 3, 6, 7 })
    requireEntry("K", i, info.K[i], 0.0);
  requireEntry("K", 8, info.K[8], 1.0);

  // Drivers of one camera leave R and P unset; set, they must say what K says.
  if (!allZero(info.R.begin(), info.R.end()))
    for (std::size_t i = 0; i < 9; ++i)
      requireEntry("R", i, info.R[i], i % 4 == 0 ? 1.0 : 0.0);
  if (!allZero(info.P.begin(), info.P.end()))
    for (std::size_t i = 0; i < 12; ++i)
      requireEntry("P", i, info.P[i], i % 4 == 3 ? 0.0 : info.K[3 * (i / 4) + i % 4]);

  for (std::size_t i = 0; i < info.D.size(); ++i)
    if (info.D[i] != 0.0)
      refuse("camera_info.D[" + std::to_string(i) + "]", info.D[i], "0: an image without distortion");
}

void requireFullImage(const sensor_msgs::CameraInfo& info)
{
  if (info.binning_x > 1)
    refuse("camera_info.binning_x", info.binning_x, "0 or 1: an image without binning");
  if (info.binning_y > 1)
    refuse("camera_info.binning_y", info.binning_y, "0 or 1: an image without binning");
  const sensor_msgs::RegionOfInterest& roi = info.roi;
  const bool whole = (roi.width == 0 || roi.width == info.width) && (roi.height == 0 || roi.height == info.height);
  if (roi.x_offset != 0 || roi.y_offset != 0 || !whole)
  {
    std::ostringstream value;
    value << roi.width << " x " << roi.height << " at (" << roi.x_offset << ", " << roi.y_offset << ")";
    refuse("camera_info.roi", value.str(), "none: the whole image");
  }
}

int intFromUnsigned(const std::string& field, std::uint32_t value)
{
  // Half the range, so that an offset and a size add up to an int.
  constexpr std::uint32_t kMaximum = std::numeric_limits<int>::max() / 2;
  if (value > kMaximum)
    refuse(field, value, "at most " + std::to_string(kMaximum) + " px");
  return static_cast<int>(value);
}

std::uint32_t unsignedFromInt(const std::string& field, int value)
{
  if (value < 0)
    refuse(field, value, "0 px or more");
  return static_cast<std::uint32_t>(value);
}
}  // namespace

std::string opticalFrame(const std::string& detector)
{
  return detector + "_optical_frame";
}

std::int64_t nanosecondsFromTime(const ros::Time& time)
{
  return static_cast<std::int64_t>(time.toNSec());
}

ros::Time timeFromNanoseconds(std::int64_t nanoseconds)
{
  constexpr std::int64_t kPerSecond = 1000000000;
  if (nanoseconds < 0 || nanoseconds / kPerSecond > std::numeric_limits<std::uint32_t>::max())
    refuse("time [ns]", nanoseconds, "0 to 2^32 s");
  return ros::Time(static_cast<std::uint32_t>(nanoseconds / kPerSecond),
                   static_cast<std::uint32_t>(nanoseconds % kPerSecond));
}

geometry_msgs::Transform transformMsgFromRigid(const RigidTransform& transform)
{
  geometry_msgs::Transform message;
  message.translation = vectorMsgFromMillimetres(transform.translation());
  message.rotation = quaternionMsg(transform);
  return message;
}

RigidTransform rigidFromTransformMsg(const geometry_msgs::Transform& message)
{
  return rigidFromMsg("translation", millimetresFromMsg("translation", message.translation), "rotation",
                      message.rotation);
}

geometry_msgs::Pose poseMsgFromRigid(const RigidTransform& transform)
{
  geometry_msgs::Pose message;
  message.position = pointMsgFromMillimetres(transform.translation());
  message.orientation = quaternionMsg(transform);
  return message;
}

RigidTransform rigidFromPoseMsg(const geometry_msgs::Pose& message)
{
  return rigidFromMsg("position", millimetresFromMsg("position", message.position), "orientation", message.orientation);
}

geometry_msgs::Point pointMsgFromMillimetres(const Eigen::Vector3d& point)
{
  return xyzMsg<geometry_msgs::Point>(point);
}

geometry_msgs::Vector3 vectorMsgFromMillimetres(const Eigen::Vector3d& vector)
{
  return xyzMsg<geometry_msgs::Vector3>(vector);
}

geometry_msgs::PoseWithCovariance poseWithCovarianceMsg(const RigidTransform& transform,
                                                        const Eigen::Matrix<double, 6, 6>& covariance)
{
  geometry_msgs::PoseWithCovariance message;
  message.pose = poseMsgFromRigid(transform);
  const Eigen::Matrix<double, 6, 1> unit = poseUnit(1.0 / kMillimetresPerMetre);
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(message.covariance.data()) =
      unit.asDiagonal() * covariance * unit.asDiagonal();
  return message;
}

Eigen::Matrix<double, 6, 6> covarianceFromPoseMsg(const geometry_msgs::PoseWithCovariance& message)
{
  const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> covariance(message.covariance.data());
  if (!covariance.allFinite())
    refuse("covariance", covariance, "finite numbers");
  const Eigen::Matrix<double, 6, 1> unit = poseUnit(kMillimetresPerMetre);
  return unit.asDiagonal() * covariance * unit.asDiagonal();
}

boost::array<double, 9> covarianceMsgFromMillimetres(const Eigen::Matrix3d& covariance)
{
  boost::array<double, 9> message;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(message.data()) =
      covariance / (kMillimetresPerMetre * kMillimetresPerMetre);
  return message;
}

sensor_msgs::CameraInfo cameraInfoFromGeometry(const ProjectionGeometry& geometry)
{
  sensor_msgs::CameraInfo info;
  info.header.frame_id = opticalFrame(geometry.name());
  info.width = static_cast<std::uint32_t>(geometry.imageSize().x());
  info.height = static_cast<std::uint32_t>(geometry.imageSize().y());
  info.distortion_model = "plumb_bob";
  info.D.assign(5, 0.0);
  const Eigen::Vector2d& focal = geometry.focalLength();
  const Eigen::Vector2d& foot = geometry.foot();
  info.K = { focal.x(), 0.0, foot.x(), 0.0, focal.y(), foot.y(), 0.0, 0.0, 1.0 };
  info.R = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
  info.P = { focal.x(), 0.0, foot.x(), 0.0, 0.0, focal.y(), foot.y(), 0.0, 0.0, 0.0, 1.0, 0.0 };
  return info;
}

ProjectionGeometry geometryFromCameraInfo(const std::string& name, const sensor_msgs::CameraInfo& info,
                                          const RigidTransform& room_from_optical, double source_to_detector)
{
  requirePinhole(info);
  requireFullImage(info);
  const Eigen::Vector2i size(intFromUnsigned("camera_info.width", info.width),
                             intFromUnsigned("camera_info.height", info.height));
  return ProjectionGeometry::fromIntrinsics(name, size, { info.K[0], info.K[4] }, { info.K[2], info.K[5] },
                                            room_from_optical, source_to_detector);
}

cv::Rect rectFromRegionMsg(const sensor_msgs::RegionOfInterest& message)
{
  return { intFromUnsigned("x_offset", message.x_offset), intFromUnsigned("y_offset", message.y_offset),
           intFromUnsigned("width", message.width), intFromUnsigned("height", message.height) };
}

sensor_msgs::RegionOfInterest regionMsgFromRect(const cv::Rect& rect)
{
  sensor_msgs::RegionOfInterest message;
  message.x_offset = unsignedFromInt("x_offset", rect.x);
  message.y_offset = unsignedFromInt("y_offset", rect.y);
  message.width = unsignedFromInt("width", rect.width);
  message.height = unsignedFromInt("height", rect.height);
  return message;
}
}  // namespace xray_tracking
