#include "motion_messages.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::RefinementResult;
using RefinePose = xray_tracking_msgs::RefinePose;

static_assert(static_cast<int>(MotionState::OK) == PatientMotion::OK);
static_assert(static_cast<int>(MotionState::WAITING) == PatientMotion::WAITING);
static_assert(static_cast<int>(MotionState::LOST) == PatientMotion::LOST);
static_assert(static_cast<int>(MotionState::INCONSISTENT) == PatientMotion::INCONSISTENT);
static_assert(static_cast<int>(MotionState::NO_REFERENCE) == PatientMotion::NO_REFERENCE);
static_assert(static_cast<int>(MotionState::BAD_STAMP) == PatientMotion::BAD_STAMP);
static_assert(static_cast<int>(MotionState::UNREGISTERED) == PatientMotion::UNREGISTERED);
static_assert(static_cast<int>(PoseSource::NONE) == PatientMotion::NONE);
static_assert(static_cast<int>(PoseSource::TRACKED) == PatientMotion::TRACKED);
static_assert(static_cast<int>(PoseSource::REGISTERED) == PatientMotion::REGISTERED);

/// Of numbers that others have sent too: what ros::Duration does not hold would throw.
ros::Duration durationFromSeconds(double seconds)
{
  return ros::Duration(std::clamp(seconds, 0.0, 1e9));
}

/// @param status other than SUCCESS
std::string statusInWords(std::uint8_t status)
{
  switch (status)
  {
    case RefinementResult::UNRELIABLE:
      return "does not believe what it found";
    case RefinementResult::TIMED_OUT:
      return "ran out of time";
    case RefinementResult::CANCELLED:
      return "was broken off";
    case RefinementResult::INVALID:
      return "cannot do what is asked";
    case RefinementResult::NO_VOLUME:
      return "has no CT";
    case RefinementResult::NO_EXPOSURE:
      return "does not have the exposure";
    case RefinementResult::BUSY:
      return "is at another request";
    default:
      return "answers with the unknown status " + std::to_string(status);
  }
}
}  // namespace

RefinementReply replyFrom(std::uint64_t id, const std::optional<RefinePose::Response>& response, const std::string& why,
                          const std::vector<std::string>& compared, const std::vector<std::string>& views)
{
  RefinementReply reply;
  reply.id = id;
  reply.text = why;
  if (!response)
  {
    return reply;
  }
  const RefinementResult& result = response->result;
  if (result.status != RefinementResult::SUCCESS)
  {
    reply.text = "the registration " + statusInWords(result.status) + ": " + result.reason;
    return reply;
  }
  try
  {
    reply.room_from_patient = rigidFromPoseMsg(result.pose.pose);
    reply.covariance = covarianceFromPoseMsg(result.pose);
    reply.seed_similarity = result.similarity_before;
    reply.similarity = result.similarity_after;
    std::vector<double> similarities;
    for (const xray_tracking_msgs::ViewResidual& view : result.views)
    {
      similarities.push_back(view.similarity);
      if (!std::isfinite(view.pull))
      {
        throw std::invalid_argument("a view's pull is " + std::to_string(view.pull) + ", expected a number");
      }
      reply.pull = std::max(reply.pull, kMillimetresPerMetre * view.pull);
    }
    reply.view_similarities = ofViews(similarities, compared, views);
    reply.success = true;
  }
  catch (const std::exception& error)  // of a pose that is none
  {
    reply.text = error.what();
  }
  return reply;
}

PatientMotion patientMotionFrom(const MotionDecision& decision, PoseMethod method)
{
  PatientMotion motion;
  motion.header.stamp = timeFromNanoseconds(decision.stamp);
  motion.header.frame_id = kRoomFrame;
  motion.state = static_cast<std::uint8_t>(decision.state);
  motion.reason = decision.reason;
  motion.method = poseMethodName(method);
  motion.source = static_cast<std::uint8_t>(decision.source);
  motion.not_registered = decision.not_registered;
  motion.translation = vectorMsgFromMillimetres(decision.displacement);
  motion.covariance = covarianceMsgFromMillimetres(decision.displacement_covariance);
  motion.views_differ = static_cast<std::uint8_t>(decision.views_differ);
  motion.disagreement = decision.disagreement;
  motion.chi_square = decision.chi_square;
  motion.degrees_of_freedom = static_cast<std::uint32_t>(decision.degrees_of_freedom);
  motion.views = static_cast<std::uint32_t>(decision.views);
  motion.cpu_time = durationFromSeconds(decision.cpu_seconds);
  motion.wall_time = durationFromSeconds(decision.wall_seconds);
  return motion;
}

geometry_msgs::PoseWithCovarianceStamped poseStampedFrom(std::int64_t stamp, const RigidTransform& room_from_patient,
                                                         const PoseCovariance& covariance)
{
  geometry_msgs::PoseWithCovarianceStamped pose;
  pose.header.stamp = timeFromNanoseconds(stamp);
  pose.header.frame_id = kRoomFrame;
  pose.pose = poseWithCovarianceMsg(room_from_patient, covariance);
  return pose;
}
}  // namespace xray_tracking
