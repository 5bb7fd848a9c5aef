#include "xray_tracking_tools/treatment_room_publisher_ros.h"

#include <stdexcept>

#include <std_msgs/String.h>
#include <nlohmann/json.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_tools/recording.h"
#include "xray_tracking_tools/treatment_room_markers.h"

namespace xray_tracking
{
namespace
{
constexpr double kGateSilence = 0.5;    // [s]; it comes every 20 ms
constexpr double kRegionSilence = 2.0;  // [s]; what a tracker said earlier is told as old

nlohmann::json jsonOf(XmlRpc::XmlRpcValue value)
{
  nlohmann::json json;
  switch (value.getType())
  {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return static_cast<bool>(value);
    case XmlRpc::XmlRpcValue::TypeInt:
      return static_cast<int>(value);
    case XmlRpc::XmlRpcValue::TypeDouble:
      return static_cast<double>(value);
    case XmlRpc::XmlRpcValue::TypeString:
      return static_cast<std::string>(value);
    case XmlRpc::XmlRpcValue::TypeArray:
      for (int k = 0; k < value.size(); ++k)
      {
        json.push_back(jsonOf(value[k]));
      }
      return json;
    case XmlRpc::XmlRpcValue::TypeStruct:
      for (auto& [key, member] : value)
      {
        json[key] = jsonOf(member);
      }
      return json;
    default:
      return value.toXml();
  }
}
}  // namespace

TreatmentRoomPublisherRos::TreatmentRoomPublisherRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh) : nh_(nh)
{
  try
  {
    start(pnh);
  }
  catch (const std::exception& e)
  {
    ROS_ERROR("treatment_room_publisher stays idle until it is started again with what it needs: %s", e.what());
  }
}

void TreatmentRoomPublisherRos::start(const ros::NodeHandle& pnh)
{
  ParameterReader reader(pnh);
  const std::string setup_file = reader.read("setup_file", std::string());
  if (setup_file.empty())
  {
    throw std::invalid_argument("~setup_file is empty, expected the path of a setup file");
  }
  const int trail_length = reader.read("trail_length", 1000);
  if (trail_length < 2)
  {
    throw std::invalid_argument("~trail_length is " + std::to_string(trail_length) + ", expected 2 or more");
  }
  reader.warnOfUnread();
  setup_ = loadTreatmentSetup(setup_file);
  trail_length_ = trail_length;
  static_markers_ = staticMarkers(setup_);
  gate_marker_ = gateMarker(false, "nothing on beam_gate");
  broadcaster_.sendTransform(staticTransforms(setup_));

  // For recordings, which are to be evaluated by what is in them.
  RunDescription description = describeRun(setup_file);
  XmlRpc::XmlRpcValue parameters;
  ros::param::get("/", parameters);
  description.parameters = jsonOf(parameters).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  std_msgs::String text;
  text.data = textOf(description);
  description_publisher_ = nh_.advertise<std_msgs::String>(kRunDescriptionTopic, 1, true);
  description_publisher_.publish(text);

  // Ten times a second is enough for the eye; a marker array for each message of each detector would load RViz.
  marker_publisher_ = nh_.advertise<visualization_msgs::MarkerArray>("treatment_room_markers", 1, true);
  timer_ = nh_.createWallTimer(ros::WallDuration(0.1), [this](const ros::WallTimerEvent&) { publishMarkers(); });
  publishMarkers();
  for (std::size_t d = 0; d < setup_.detectors.size(); ++d)
  {
    region_subscribers_.push_back(nh_.subscribe<xray_tracking_msgs::TrackedRegion>(
        setup_.detectors[d].name() + "/tracked_region", 10,
        [this, d](const xray_tracking_msgs::TrackedRegion::ConstPtr& message) { regionCallback(d, *message); }));
  }
  gate_subscriber_ = nh_.subscribe("beam_gate", 10, &TreatmentRoomPublisherRos::gateCallback, this);
  pose_subscriber_ = nh_.subscribe("patient_pose", 100, &TreatmentRoomPublisherRos::poseCallback, this);
}

void TreatmentRoomPublisherRos::poseCallback(const geometry_msgs::PoseWithCovarianceStamped& message)
{
  try
  {
    const RigidTransform room_from_patient = rigidFromPoseMsg(message.pose.pose);
    using Verdict = StampPolicy::Verdict;
    const Verdict verdict =
        pose_stamps_.take(nanosecondsFromTime(message.header.stamp), nanosecondsFromTime(ros::Time::now()));
    if (verdict == Verdict::FUTURE || verdict == Verdict::REPEATED_OR_LATE)
    {
      throw std::invalid_argument(pose_stamps_.why());
    }
    if (verdict == Verdict::RESTART)
    {
      trail_.clear();
    }
    if (trail_.size() == trail_length_)
    {
      trail_.erase(trail_.begin());
    }
    trail_.push_back(pointMsgFromMillimetres(room_from_patient * setup_.targetCentre()));
    changed_ = true;
  }
  catch (const std::invalid_argument& e)
  {
    ROS_WARN_THROTTLE(1.0, "patient_pose is left out of the trail: %s", e.what());
  }
}

void TreatmentRoomPublisherRos::regionCallback(std::size_t detector, const xray_tracking_msgs::TrackedRegion& message)
{
  regions_[detector] = { regionMarkers(setup_.detectors[detector], static_cast<int>(detector), message),
                         ros::SteadyTime::now() };
  changed_ = true;
}

void TreatmentRoomPublisherRos::gateCallback(const xray_tracking_msgs::BeamGate& message)
{
  last_gate_ = ros::SteadyTime::now();
  // Simulated time may run faster than messages do, or stand still.
  const bool valid = ros::Time::isSimTime() || ros::Time::now() <= message.valid_until;
  showGate(valid && message.open != 0 && message.reason == xray_tracking_msgs::BeamGate::NONE,
           valid ? message.text : "what comes on beam_gate is not valid any more");
}

void TreatmentRoomPublisherRos::showGate(bool open, const std::string& why)
{
  const visualization_msgs::Marker marker = gateMarker(open, why);
  changed_ = changed_ || marker.text != gate_marker_.text;
  gate_marker_ = marker;
}

void TreatmentRoomPublisherRos::publishMarkers()
{
  if ((ros::SteadyTime::now() - last_gate_).toSec() > kGateSilence)
  {
    showGate(false, "nothing on beam_gate");
  }
  for (auto& [detector, region] : regions_)
  {
    if (!region.old && (ros::SteadyTime::now() - region.arrival).toSec() > kRegionSilence)
    {
      region.old = changed_ = true;
      fade(region.markers);
    }
  }
  if (!changed_)
  {
    return;
  }
  changed_ = false;
  // Always everything: a latched topic keeps one message for those who come later.
  visualization_msgs::MarkerArray message;
  message.markers = static_markers_;
  for (const auto& [detector, region] : regions_)
  {
    message.markers.insert(message.markers.end(), region.markers.begin(), region.markers.end());
  }
  message.markers.push_back(trailMarker(trail_));
  message.markers.push_back(gate_marker_);
  marker_publisher_.publish(message);
}
}  // namespace xray_tracking
