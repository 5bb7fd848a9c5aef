#pragma once

#include <cstdint>
#include <string>

#include <Eigen/Core>
#include <boost/array.hpp>
#include <opencv2/core.hpp>

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/PoseWithCovariance.h>
#include <geometry_msgs/Transform.h>
#include <geometry_msgs/Vector3.h>
#include <ros/time.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/RegionOfInterest.h>

#include "xray_tracking_core/geometry/projection_geometry.h"

/// Messages (metres) to core types (millimetres) and back: the one place where both meet. What comes from a message is
/// checked: @throws std::invalid_argument naming the field and its value.
namespace xray_tracking
{
constexpr double kMillimetresPerMetre = 1000.0;

constexpr const char* kRoomFrame = "treatment_room";
constexpr const char* kPatientFrame = "patient";
constexpr const char* kTargetFrame = "target";
constexpr const char* kGroundTruthFrame = "patient_ground_truth";
/// `<detector>_optical_frame`
std::string opticalFrame(const std::string& detector);

std::int64_t nanosecondsFromTime(const ros::Time& time);
ros::Time timeFromNanoseconds(std::int64_t nanoseconds);

geometry_msgs::Transform transformMsgFromRigid(const RigidTransform& transform);
RigidTransform rigidFromTransformMsg(const geometry_msgs::Transform& message);
geometry_msgs::Pose poseMsgFromRigid(const RigidTransform& transform);
RigidTransform rigidFromPoseMsg(const geometry_msgs::Pose& message);
geometry_msgs::Point pointMsgFromMillimetres(const Eigen::Vector3d& point);
geometry_msgs::Vector3 vectorMsgFromMillimetres(const Eigen::Vector3d& vector);

/// @param covariance of (translation [mm], rotation vector about the fixed axes [rad]), in this order
geometry_msgs::PoseWithCovariance poseWithCovarianceMsg(const RigidTransform& transform,
                                                        const Eigen::Matrix<double, 6, 6>& covariance);

/// The covariance of such a message, in mm and rad. @throws std::invalid_argument if it is not finite
Eigen::Matrix<double, 6, 6> covarianceFromPoseMsg(const geometry_msgs::PoseWithCovariance& message);

/// Row-major. @param covariance [mm^2]; @return [m^2]
boost::array<double, 9> covarianceMsgFromMillimetres(const Eigen::Matrix3d& covariance);

/// The projection as an undistorted pinhole camera (docs/frames.md): K = P = [fx 0 cx; 0 fy cy; 0 0 1], `plumb_bob`
/// with five zeros; frame_id is the detector's optical frame, the stamp is left at zero.
sensor_msgs::CameraInfo cameraInfoFromGeometry(const ProjectionGeometry& geometry);
/// @param room_from_optical pose of the camera's frame; @param source_to_detector [mm], see
/// ProjectionGeometry::fromIntrinsics. Rejects distortion, binning and an acquisition ROI.
ProjectionGeometry geometryFromCameraInfo(const std::string& name, const sensor_msgs::CameraInfo& info,
                                          const RigidTransform& room_from_optical, double source_to_detector);

cv::Rect rectFromRegionMsg(const sensor_msgs::RegionOfInterest& message);
sensor_msgs::RegionOfInterest regionMsgFromRect(const cv::Rect& rect);
}  // namespace xray_tracking
