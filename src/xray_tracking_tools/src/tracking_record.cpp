#include "xray_tracking_tools/tracking_record.h"

#include <algorithm>
#include <cstdio>
#include <stdexcept>
#include <utility>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <sensor_msgs/CameraInfo.h>
#include <xray_tracking_msgs/BeamGate.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
/// Of what the registration said by itself, beside the poses that were published.
constexpr const char* kRegistration = "registration";
constexpr const char* kNoPose = "beam_gate never had a pose to judge";

using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::RefinedPose;
using xray_tracking_msgs::RefinementResult;

std::string secondsText(std::int64_t stamp_ns)
{
  char text[32];
  std::snprintf(text, sizeof(text), "%.4f s", stamp_ns * 1e-9);
  return text;
}

template <typename T>
void insertOnce(std::map<std::int64_t, T>& by_stamp, std::int64_t stamp_ns, const T& value)
{
  if (!by_stamp.emplace(stamp_ns, value).second)
  {
    throw std::invalid_argument("two messages of one exposure");
  }
}

void readGate(const BeamGate& gate, std::int64_t epoch_ns, TrackingRecord& record)
{
  const std::int64_t exposure_ns = nanosecondsFromTime(gate.exposure) - epoch_ns;
  if (gate.verified)
  {
    record.verified.insert(exposure_ns);
  }
  if (gate.open)
  {
    record.gate_open.insert(exposure_ns);
  }
  if (gate.reason == BeamGate::UNVERIFIED)
  {
    record.unverified = gate.text;
  }
  else if (record.unverified.empty())
  {
    record.unverified = gate.reason == BeamGate::NOT_MEASURED ? kNoPose + (": " + gate.text) : kNoPose;
  }
  else if (record.unverified.rfind(kNoPose, 0) == 0 && gate.reason == BeamGate::NOT_MEASURED)
  {
    record.unverified = std::string(kNoPose) + ": " + gate.text;
  }
}

void readMessage(const rosbag::MessageInstance& instance, const std::string& topic, std::int64_t epoch_ns,
                 TrackingRecord& record)
{
  std::int64_t stamp_ns = 0;
  try
  {
    if (const auto gate = instance.instantiate<BeamGate>())
    {
      readGate(*gate, epoch_ns, record);
      return;
    }
    if (const auto motion = instance.instantiate<PatientMotion>())
    {
      stamp_ns = nanosecondsFromTime(motion->header.stamp) - epoch_ns;
      if (motion->state > PatientMotion::UNREGISTERED)
      {
        throw std::invalid_argument("state is " + std::to_string(motion->state) + ", expected 0 to 6");
      }
      if (!record.motions.empty() && record.motions.begin()->second.method != motion->method)
      {
        throw std::invalid_argument("method is " + motion->method + ", that of others is " +
                                    record.motions.begin()->second.method);
      }
      insertOnce(record.motions, stamp_ns, *motion);
    }
    else if (const auto refined = instance.instantiate<RefinedPose>())
    {
      stamp_ns = nanosecondsFromTime(refined->header.stamp) - epoch_ns;
      if (refined->result.status > RefinementResult::BUSY)
      {
        throw std::invalid_argument("status is " + std::to_string(refined->result.status) + ", expected 0 to 7");
      }
      // Of one that was not found when it was first asked about, what was said once it had come.
      if (const auto earlier = record.refined_poses.find(stamp_ns);
          earlier != record.refined_poses.end() && earlier->second.result.status == RefinementResult::NO_EXPOSURE)
      {
        record.refined_poses.erase(earlier);
      }
      insertOnce(record.refined_poses, stamp_ns, *refined);
    }
    else if (const auto pose = instance.instantiate<geometry_msgs::PoseWithCovarianceStamped>())
    {
      stamp_ns = nanosecondsFromTime(pose->header.stamp) - epoch_ns;
      insertOnce(record.poses, stamp_ns, rigidFromPoseMsg(pose->pose.pose));
    }
    else if (const auto truth = instance.instantiate<geometry_msgs::PoseStamped>())
    {
      stamp_ns = nanosecondsFromTime(truth->header.stamp) - epoch_ns;
      insertOnce(record.ground_truth, stamp_ns, rigidFromPoseMsg(truth->pose));
    }
    else if (const auto info = instance.instantiate<sensor_msgs::CameraInfo>())
    {
      stamp_ns = nanosecondsFromTime(info->header.stamp) - epoch_ns;
    }
    else
    {
      throw std::invalid_argument("messages are " + instance.getDataType());
    }
  }
  catch (const std::invalid_argument& e)
  {
    throw std::runtime_error(topic + " at " + secondsText(stamp_ns) + ": " + e.what());
  }
  record.exposures.insert(stamp_ns);
}

/// The pose that was published.
FrameResult publishedResult(const TrackingRecord& record, std::int64_t stamp_ns)
{
  FrameResult result;
  const auto motion = record.motions.find(stamp_ns);
  if (motion == record.motions.end())
  {
    return result;
  }
  result.cpu_s = motion->second.cpu_time.toSec();
  result.wall_s = motion->second.wall_time.toSec();
  if (const auto refined = record.refined_poses.find(stamp_ns); refined != record.refined_poses.end())
  {
    result.cpu_s += refined->second.cpu_time.toSec();
  }
  if (motion->second.state != PatientMotion::OK)
  {
    result.status = FrameStatus::LOST;
    return result;
  }
  const auto pose = record.poses.find(stamp_ns);
  if (pose != record.poses.end())
  {
    result.status = FrameStatus::OK;
    result.room_from_patient = pose->second;
  }
  return result;
}

/// What the registration said by itself.
FrameResult refinedResult(const TrackingRecord& record, std::int64_t stamp_ns)
{
  FrameResult result;
  const auto refined = record.refined_poses.find(stamp_ns);
  if (refined == record.refined_poses.end())
  {
    return result;
  }
  result.cpu_s = refined->second.cpu_time.toSec();
  result.wall_s = refined->second.wall_time.toSec();
  const bool success = refined->second.result.status == RefinementResult::SUCCESS;
  result.status = success ? FrameStatus::OK : FrameStatus::LOST;
  if (success)
  {
    result.room_from_patient = rigidFromPoseMsg(refined->second.result.pose.pose);
  }
  return result;
}

void addMethods(const TrackingRecord& record, Evaluation& evaluation)
{
  MethodResult published;
  published.method = record.motions.empty() ? "tracking" : record.motions.begin()->second.method;
  MethodResult refined;
  refined.method = kRegistration;
  for (const std::int64_t stamp_ns : evaluation.stamps_ns)
  {
    published.frames.push_back(publishedResult(record, stamp_ns));
    refined.frames.push_back(refinedResult(record, stamp_ns));
  }
  const bool both = !record.refined_poses.empty() && published.method != kRegistration;
  evaluation.methods.push_back(std::move(published));
  if (both)
  {
    evaluation.methods.push_back(std::move(refined));
  }
}

/// Why no pose of a frame was published.
std::string publishedReason(const TrackingRecord& record, std::int64_t stamp_ns)
{
  const auto motion = record.motions.find(stamp_ns);
  if (motion == record.motions.end())
  {
    return "no patient_motion";
  }
  return motion->second.state == PatientMotion::OK ? "patient_motion without patient_pose" : motion->second.reason;
}

std::string refinedReason(const TrackingRecord& record, std::int64_t stamp_ns)
{
  const auto refined = record.refined_poses.find(stamp_ns);
  return refined == record.refined_poses.end() ? "no refined_pose" : refined->second.result.reason;
}
}  // namespace

TrackingRecord readTrackingRecord(const std::string& bag_path, std::int64_t epoch_ns)
{
  const Recording recording(bag_path);
  try
  {
    TrackingRecord record;
    const auto view = recording.messages(
        [](const rosbag::ConnectionInfo* connection)
        {
          const std::string name = lastName(connection->topic);
          return name == "patient_motion" || name == "patient_pose" || name == "refined_pose" ||
                 name == "patient_ground_truth" || name == "camera_info" || name == "beam_gate";
        });
    for (const rosbag::MessageInstance& instance : *view)
    {
      readMessage(instance, instance.getTopic(), epoch_ns, record);
    }
    return record;
  }
  catch (const std::exception& e)
  {
    throw std::runtime_error(bag_path + ": " + e.what());
  }
}

Evaluation evaluateRecord(const TrackingRecord& record, const std::string& name, const Eigen::AlignedBox3d& target_box)
{
  if (record.exposures.empty())
  {
    throw std::runtime_error("the bag has no exposure: no patient_motion, patient_ground_truth or camera_info");
  }
  Evaluation evaluation;
  evaluation.sequence = name;
  evaluation.target_box = target_box;
  for (const std::int64_t stamp_ns : record.exposures)
  {
    evaluation.stamps_ns.push_back(stamp_ns);
    if (record.ground_truth.empty())
    {
      continue;
    }
    const auto truth = record.ground_truth.find(stamp_ns);
    if (truth == record.ground_truth.end())
    {
      throw std::runtime_error("the exposure at " + secondsText(stamp_ns) +
                               " has no patient_ground_truth, others have");
    }
    evaluation.gold_standard.push_back(truth->second);
  }
  addMethods(record, evaluation);
  return evaluation;
}

Evaluation evaluateRecord(const TrackingRecord& record, const std::string& name, const Sequence& sequence)
{
  Evaluation evaluation;
  evaluation.sequence = name;
  evaluation.target_box = sequence.setup.target_box;
  for (const Exposure& exposure : sequence.exposures)
  {
    evaluation.stamps_ns.push_back(exposure.stamp_ns);
  }
  for (const StampedPose& pose : sequence.gold_standard)
  {
    evaluation.gold_standard.push_back(pose.room_from_patient);
  }
  const std::set<std::int64_t> stamps_ns(evaluation.stamps_ns.begin(), evaluation.stamps_ns.end());
  for (const std::int64_t stamp_ns : record.exposures)
  {
    if (stamps_ns.count(stamp_ns) == 0)
    {
      throw std::runtime_error("the bag's exposure at " + secondsText(stamp_ns) + " is none of the sequence's");
    }
  }
  addMethods(record, evaluation);
  return evaluation;
}

GateCounts gateCounts(const Evaluation& evaluation, const TrackingRecord& record)
{
  const auto count = [&](const std::set<std::int64_t>& exposures)
  {
    return static_cast<int>(std::count_if(evaluation.stamps_ns.begin(), evaluation.stamps_ns.end(),
                                          [&](std::int64_t stamp) { return exposures.count(stamp) != 0; }));
  };
  return { count(record.verified), count(record.gate_open) };
}

std::vector<std::string> unansweredExposures(const Evaluation& evaluation, const TrackingRecord& record)
{
  std::vector<std::string> lines;
  for (const MethodResult& method : evaluation.methods)
  {
    const bool published = &method == &evaluation.methods.front();
    for (std::size_t k = 0; k < method.frames.size(); ++k)
    {
      if (method.frames[k].status == FrameStatus::OK)
      {
        continue;
      }
      const std::int64_t stamp_ns = evaluation.stamps_ns[k];
      lines.push_back("frame " + std::to_string(k) + " (" + secondsText(stamp_ns) + ") of " + method.method +
                      (method.frames[k].status == FrameStatus::LOST ? " lost: " : " failed: ") +
                      (published ? publishedReason(record, stamp_ns) : refinedReason(record, stamp_ns)));
    }
  }
  return lines;
}
}  // namespace xray_tracking
