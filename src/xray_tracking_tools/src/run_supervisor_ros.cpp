#include "xray_tracking_tools/run_supervisor_ros.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include <ros/service.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/parameters.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

/// Time that recorders get to take what was published last [s].
constexpr double kFlushTime = 1.0;

const char* stateName(std::uint8_t state)
{
  switch (state)
  {
    case PatientMotion::OK:
      return "OK";
    case PatientMotion::WAITING:
      return "WAITING";
    case PatientMotion::LOST:
      return "LOST";
    case PatientMotion::INCONSISTENT:
      return "INCONSISTENT";
    case PatientMotion::NO_REFERENCE:
      return "NO_REFERENCE";
    case PatientMotion::BAD_STAMP:
      return "BAD_STAMP";
    case PatientMotion::UNREGISTERED:
      return "UNREGISTERED";
    default:
      return "state unknown";
  }
}

void print(const std::string& line)
{
  std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

std::vector<std::string> stringList(XmlRpc::XmlRpcValue& value, const std::string& key)
{
  std::vector<std::string> strings;
  bool valid = value.getType() == XmlRpc::XmlRpcValue::TypeArray && value.size() > 0;
  for (int i = 0; valid && i < value.size(); ++i)
  {
    valid = value[i].getType() == XmlRpc::XmlRpcValue::TypeString;
    if (valid)
    {
      strings.push_back(static_cast<std::string&>(value[i]));
    }
  }
  if (!valid)
  {
    throw std::invalid_argument(key + " is not a list of names");
  }
  return strings;
}

/// tf is in no namespace.
std::string resolveTopic(const ros::NodeHandle& topics, const std::string& topic)
{
  return topic == "tf" || topic == "tf_static" ? "/" + topic : topics.resolveName(topic);
}

/// Topics, relative to a namespace, to names. The parameter server makes nested maps of topics with slashes:
/// {detector_a: {image_raw: [names]}}.
void addRequiredSubscribers(XmlRpc::XmlRpcValue& value, const std::string& key, const ros::NodeHandle& topics,
                            const ros::NodeHandle& nodes, RequiredSubscribers& required, const std::string& topic = "")
{
  if (value.getType() == XmlRpc::XmlRpcValue::TypeStruct)
  {
    for (auto& [name, inner] : value)
    {
      addRequiredSubscribers(inner, key, topics, nodes, required, topic.empty() ? name : topic + "/" + name);
    }
    return;
  }
  if (topic.empty())
  {
    throw std::invalid_argument(key + " is not a map from topics to lists of node names");
  }
  for (const std::string& name : stringList(value, key + "/" + topic))
  {
    required[resolveTopic(topics, topic)].push_back(nodes.resolveName(name));
  }
}
}  // namespace

RunSupervisorRos::RunSupervisorRos(ros::NodeHandle nh, const ros::NodeHandle& pnh)
{
  ParameterReader reader(pnh);
  const int exposures = reader.read("exposures", 0);
  if (exposures < 1)
  {
    throw std::invalid_argument("~exposures is " + std::to_string(exposures) + ", expected 1 or more");
  }
  exposures_ = exposures;
  stall_timeout_s_ = reader.read("stall_timeout", 30.0);
  if (!(stall_timeout_s_ > 0.0))
  {
    throw std::invalid_argument("~stall_timeout is " + std::to_string(stall_timeout_s_) + ", expected more than 0 s");
  }
  const std::string start_mode = reader.read<std::string>("start_mode", "simulator");
  if (start_mode != "simulator" && start_mode != "playback")
  {
    throw std::invalid_argument("~start_mode is '" + start_mode + "', expected simulator or playback");
  }
  playback_ = start_mode == "playback";
  start_service_ = nh.resolveName(reader.read<std::string>("start_service", "start"));

  auto required = reader.read("required_subscribers", XmlRpc::XmlRpcValue());
  if (required.valid())
  {
    addRequiredSubscribers(required, "~required_subscribers", nh, nh, required_subscribers_);
  }
  auto required_of_detectors = reader.read("required_detector_subscribers", XmlRpc::XmlRpcValue());
  const auto names = reader.read<std::vector<std::string>>("detectors", { "detector_a", "detector_b" });
  reader.warnOfUnread();
  if (names.empty())
  {
    throw std::invalid_argument("~detectors is empty, expected the detectors' names");
  }
  for (const std::string& name : names)
  {
    if (required_of_detectors.valid())
    {
      addRequiredSubscribers(required_of_detectors, "~required_detector_subscribers", ros::NodeHandle(nh, name), nh,
                             required_subscribers_);
    }
    DetectorCounts* counts = &detectors_[name];
    subscribers_.push_back(
        nh.subscribe<sensor_msgs::CameraInfo>(name + "/camera_info", 100,
                                              [counts](const sensor_msgs::CameraInfo::ConstPtr& message)
                                              { counts->exposures.insert(message->header.stamp); }));
    subscribers_.push_back(nh.subscribe<TrackedRegion>(name + "/tracked_region", 100,
                                                       [counts](const TrackedRegion::ConstPtr& message)
                                                       {
                                                         counts->regions.insert(message->header.stamp);
                                                         counts->correlation = message->correlation;
                                                       }));
  }
  subscribers_.push_back(nh.subscribe("patient_motion", 1000, &RunSupervisorRos::motionCallback, this));
  // It would count wrong if it missed the first messages.
  for (const ros::Subscriber& subscriber : subscribers_)
  {
    required_subscribers_[subscriber.getTopic()].push_back(ros::this_node::getName());
  }
  timer_ = nh.createSteadyTimer(ros::WallDuration(0.1), [this](const ros::SteadyTimerEvent&) { tick(); });
}

int RunSupervisorRos::run()
{
  last_event_ = last_print_ = ros::SteadyTime::now();
  // A thread of its own, as it waits for other processes, which may hang.
  std::thread starter([this] { startWhenConnected(); });
  ros::spin();
  if (started_)
  {
    starter.join();
  }
  else
  {
    starter.detach();
  }
  return exit_status_;
}

void RunSupervisorRos::startWhenConnected()
{
  while (ros::ok())
  {
    const std::vector<std::string> missing = missingConnections(required_subscribers_);
    std::string waiting_for;
    for (const std::string& text : missing)
    {
      waiting_for += (waiting_for.empty() ? "" : "; ") + text;
    }
    if (missing.empty())
    {
      waiting_for = callStartService();
      if (waiting_for.empty())
      {
        started_ = true;
        return;
      }
    }
    setWaitingFor(waiting_for);
    ros::WallDuration(0.2).sleep();
  }
}

std::string RunSupervisorRos::callStartService() const
{
  if (!ros::service::exists(start_service_, false))
  {
    return "service " + start_service_ + " is not there";
  }
  bool called = false;
  bool success = false;
  std::string message;
  if (playback_)
  {
    std_srvs::SetBool pause;
    pause.request.data = false;
    called = ros::service::call(start_service_, pause);
    success = pause.response.success;
    message = pause.response.message;
  }
  else
  {
    std_srvs::Trigger start;
    called = ros::service::call(start_service_, start);
    success = start.response.success;
    message = start.response.message;
  }
  if (called && success)
  {
    return "";
  }
  return "service " + start_service_ + (called ? " refused: " + message : " did not answer");
}

void RunSupervisorRos::setWaitingFor(const std::string& text)
{
  const std::lock_guard<std::mutex> lock(waiting_for_mutex_);
  waiting_for_ = text;
}

void RunSupervisorRos::motionCallback(const PatientMotion& message)
{
  if (!motions_.insert(message.header.stamp).second)
  {
    return;
  }
  last_event_ = ros::SteadyTime::now();
  printProgress(message);
}

void RunSupervisorRos::printProgress(const PatientMotion& message)
{
  const std::size_t count = motions_.size();
  const ros::SteadyTime now = ros::SteadyTime::now();
  if ((now - last_print_).toSec() < 1.0 && count != 1 && count != exposures_)
  {
    return;
  }
  last_print_ = now;
  char text[160];
  std::snprintf(text, sizeof(text), "exposure %zu / %zu: %s", count, exposures_, stateName(message.state));
  std::string line = text;
  if (message.state == PatientMotion::OK)
  {
    const geometry_msgs::Vector3& t = message.translation;
    std::snprintf(text, sizeof(text), ", %s, displacement %.2f mm, disagreement %.2f px, correlation",
                  message.source == PatientMotion::REGISTERED ? "registered" : "tracked",
                  std::hypot(t.x, t.y, t.z) * kMillimetresPerMetre, message.disagreement);
    line += text;
    for (const auto& [name, counts] : detectors_)
    {
      std::snprintf(text, sizeof(text), " %.3f", counts.correlation);
      line += text;
    }
  }
  else
  {
    line += ", " + message.reason;
  }
  print(line);
}

void RunSupervisorRos::tick()
{
  const ros::SteadyTime now = ros::SteadyTime::now();
  if (started_ && !start_seen_)
  {
    start_seen_ = true;
    last_event_ = now;
    print("everything is connected, the run begins");
  }
  const double quiet_s = (now - last_event_).toSec();
  if (motions_.size() >= exposures_)
  {
    if (quiet_s >= kFlushTime)
    {
      print("all " + std::to_string(exposures_) + " exposures were answered");
      exit_status_ = 0;
      ros::shutdown();
    }
  }
  else if (quiet_s >= stall_timeout_s_)
  {
    printStall();
    ros::shutdown();
  }
}

void RunSupervisorRos::printStall()
{
  char text[160];
  std::snprintf(text, sizeof(text), "stalled: %zu of %zu exposures were answered, no new patient_motion for %.1f s",
                motions_.size(), exposures_, stall_timeout_s_);
  print(text);
  if (!started_)
  {
    const std::lock_guard<std::mutex> lock(waiting_for_mutex_);
    print("  never started: " + waiting_for_);
  }
  std::size_t most = 0;
  for (const auto& [name, counts] : detectors_)
  {
    most = std::max(most, counts.exposures.size());
  }
  for (const auto& [name, counts] : detectors_)
  {
    const bool images_missing = counts.exposures.size() < std::max<std::size_t>(most, 1);
    const bool regions_missing = counts.regions.size() < counts.exposures.size();
    print("  " + name + ": " + std::to_string(counts.exposures.size()) + " exposures" +
          (images_missing ? " (" + name + "/camera_info fell silent)" : "") + ", " +
          std::to_string(counts.regions.size()) + " tracked regions" +
          (regions_missing ? " (" + name + "/tracked_region fell silent)" : ""));
  }
}
}  // namespace xray_tracking
