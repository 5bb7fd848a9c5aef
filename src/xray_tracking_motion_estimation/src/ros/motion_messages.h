#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinePose.h>

#include "xray_tracking_motion_estimation/motion_monitor.h"

/// What MotionMonitor says and hears, to messages and back.
namespace xray_tracking
{
xray_tracking_msgs::PatientMotion patientMotionFrom(const MotionDecision& decision, PoseMethod method);

/// A pose of the patient in the room, at a stamp [ns].
geometry_msgs::PoseWithCovarianceStamped poseStampedFrom(std::int64_t stamp, const RigidTransform& room_from_patient,
                                                         const PoseCovariance& covariance);

/// The answer to a request. @param why there is no response, if there is none
/// @param compared the detectors that the registration was to compare, in the order of its figures; @param views the
/// monitor's
RefinementReply replyFrom(std::uint64_t id, const std::optional<xray_tracking_msgs::RefinePose::Response>& response,
                          const std::string& why, const std::vector<std::string>& compared,
                          const std::vector<std::string>& views);
}  // namespace xray_tracking
