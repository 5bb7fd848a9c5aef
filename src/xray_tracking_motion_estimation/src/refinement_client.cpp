#include "xray_tracking_motion_estimation/refinement_client.h"

#include <chrono>
#include <exception>

#include <xray_tracking_msgs/RefinePose.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
constexpr const char* kService = "refine_pose";

RefinementReply failure(const RefinementRequest& request, const std::string& text)
{
  RefinementReply reply;
  reply.id = request.id;
  reply.text = text;
  return reply;
}
}  // namespace

bool RefinementClient::request(const RefinementRequest& request, bool unverified)
{
  if (reply_.valid())
  {
    return false;
  }
  cancelled_ = false;
  reply_ = std::async(std::launch::async, [this, request, unverified] { return call(request, unverified); });
  return true;
}

std::optional<RefinementReply> RefinementClient::takeReply()
{
  if (!reply_.valid() || reply_.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
  {
    return std::nullopt;
  }
  return reply_.get();
}

void RefinementClient::cancel()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  cancelled_ = true;
  client_.shutdown();
}

RefinementReply RefinementClient::call(const RefinementRequest& request, bool unverified)
{
  try
  {
    if (!ros::service::exists(nh_.resolveName(kService), false))
    {
      return failure(request, "there is no service " + nh_.resolveName(kService));
    }
    // Persistent, and for this one request: shutdown() breaks off no other kind of call.
    ros::ServiceClient client = nh_.serviceClient<xray_tracking_msgs::RefinePose>(kService, true);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (cancelled_)
      {
        return failure(request, "broken off");
      }
      client_ = client;
    }
    xray_tracking_msgs::RefinePose message;
    message.request.request.seed = poseMsgFromRigid(request.room_from_patient);
    message.request.request.stamp = timeFromNanoseconds(request.stamp);
    message.request.request.time_budget = time_budget_;
    message.request.request.unverified = static_cast<std::uint8_t>(unverified);
    if (!client.call(message))
    {
      return failure(request, "the call of " + nh_.resolveName(kService) + " failed or was broken off");
    }
    const xray_tracking_msgs::RefinementResult& result = message.response.result;
    if (result.status != xray_tracking_msgs::RefinementResult::SUCCESS)
    {
      return failure(request, "the registration's status is " + std::to_string(static_cast<int>(result.status)) + ": " +
                                  result.reason);
    }
    RefinementReply reply;
    reply.id = request.id;
    reply.success = true;
    reply.room_from_patient = rigidFromPoseMsg(result.pose.pose);
    reply.covariance = covarianceFromPoseMsg(result.pose);
    reply.seed_similarity = result.similarity_before;
    reply.similarity = result.similarity_after;
    return reply;
  }
  catch (const std::exception& error)  // of a pose that is none
  {
    return failure(request, error.what());
  }
}
}  // namespace xray_tracking
