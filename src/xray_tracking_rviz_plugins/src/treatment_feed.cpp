#include "treatment_feed.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <ros/master.h>
#include <Eigen/Eigenvalues>

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::RefinedPose;
using xray_tracking_msgs::RefinementResult;
using xray_tracking_msgs::TrackedRegion;

constexpr std::int64_t kSecond = 1000000000;
constexpr std::int64_t kMinute = 60 * kSecond;
constexpr std::size_t kMostValues = 4000;  // 60 Hz
constexpr double kDegrees = 180.0 / 3.14159265358979323846;
const std::string kTrackedRegion = "/tracked_region";

TreatmentFeed::Charts emptyCharts()
{
  const RecentValues<double> none(kMinute, kMostValues);
  return { none, none, none, none, none, none };
}

/// ros::master::getTopics waits for a master that is not there.
std::vector<std::string> topicsOf(const std::string& type)
{
  XmlRpc::XmlRpcValue request, response, payload;
  request[0] = ros::this_node::getName();
  std::vector<std::string> topics;
  if (ros::master::execute("getTopicTypes", request, response, payload, false) &&
      payload.getType() == XmlRpc::XmlRpcValue::TypeArray)
  {
    for (int i = 0; i < payload.size(); ++i)
    {
      if (std::string(payload[i][1]) == type)
      {
        topics.push_back(payload[i][0]);
      }
    }
  }
  return topics;
}
}  // namespace

double worstSigma(const boost::array<double, 9>& covariance)
{
  const Eigen::Matrix3d matrix = Eigen::Map<const Eigen::Matrix3d>(covariance.data());
  if (!matrix.allFinite())
  {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(matrix, Eigen::EigenvaluesOnly);
  return 1e3 * std::sqrt(std::max(0.0, axes.eigenvalues()[2]));
}

TreatmentFeed::TreatmentFeed(const ros::NodeHandle& nh, GateSaid gate_said)
  : nh_(nh),
    gate_said_(std::move(gate_said)),
    exposures_(5 * kSecond, 1000),
    charts_(emptyCharts()),
    lights_(kMinute, kMostValues)
{
  gate_subscriber_ = nh_.subscribe("beam_gate", 1, &TreatmentFeed::gateCb, this, ros::TransportHints().tcpNoDelay());
  motion_subscriber_ = nh_.subscribe("patient_motion", 100, &TreatmentFeed::motionCb, this);
  refined_subscriber_ = nh_.subscribe("refined_pose", 100, &TreatmentFeed::refinedCb, this);
  const boost::function<void(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr&)> pose_cb =
      [this](const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    pose_ = message->pose.pose;
  };
  pose_subscriber_ = nh_.subscribe<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 1, pose_cb);
}

GateView TreatmentFeed::gateNow() const
{
  return gateView(gate_, steadyNanoseconds(),
                  ros::Time::isSimTime() ? std::nullopt : std::optional<ros::Time>(ros::Time::now()));
}

void TreatmentFeed::show(TreatmentView& view) const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  view.gate = gate_;
  view.gate_view = gateNow();
  view.motion = motion_;
  view.refined = refined_;
  if (gate_ && !gate_->message.exposure.isZero())
  {
    view.exposure_age = gate_->message.age.toSec() + 1e-9 * static_cast<double>(steadyNanoseconds() - gate_->arrival);
    view.stale = *view.exposure_age > gate_->message.max_age.toSec();
    view.measured = view.gate_view.light != GateLight::SILENT && motion_ && motion_->state == PatientMotion::OK;
  }
  view.motion_arrival = motion_arrival_;
  view.refined_arrival = refined_arrival_;
  const auto& exposures = exposures_.entries();
  const auto recent = std::count_if(exposures.begin(), exposures.end(),
                                    [t = steadyNanoseconds()](const auto& e) { return e.time >= t - 5 * kSecond; });
  view.rate = static_cast<double>(recent) / 5.0;
  for (const auto& [name, tracker] : trackers_)
  {
    view.trackers.push_back(tracker->view);
  }
  view.max_displacement = max_displacement_;
  view.max_rotation = max_rotation_;
  view.max_sigma = motion_ && motion_->source == PatientMotion::REGISTERED ? max_sigma_ : max_tracked_sigma_;
}

TreatmentFeed::Charts TreatmentFeed::charts() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return charts_;
}

TreatmentFeed::Lights TreatmentFeed::lights() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return lights_;
}

std::optional<geometry_msgs::Pose> TreatmentFeed::pose() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return pose_;
}

void TreatmentFeed::noteLight()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  const GateLight light = gateNow().light;
  if (lights_.entries().empty() || lights_.entries().back().value != light)
  {
    lights_.add(steadyNanoseconds(), light);
  }
}

void TreatmentFeed::gateCb(const ros::MessageEvent<BeamGate const>& event)
{
  const BeamGate::ConstPtr& message = event.getConstMessage();
  gate_said_(*message);
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::int64_t now = steadyNanoseconds();
  gates_from_[event.getPublisherName()] = now;
  const auto lately = [&](const auto& entry) { return now - entry.second < kSecond / 2; };
  gate_ = HeardGate{ *message, now,
                     static_cast<std::size_t>(std::count_if(gates_from_.begin(), gates_from_.end(), lately)) };
  noteRotation();
}

void TreatmentFeed::noteRotation()
{
  // Only patient_motion tells whether an exposure has a pose. Where it has none, the gate repeats an earlier rotation.
  if (!gate_ || !motion_ || motion_->header.stamp != gate_->message.exposure || motion_->header.stamp == rotation_of_)
  {
    return;
  }
  rotation_of_ = motion_->header.stamp;
  const double rotation = gate_->message.rotation;
  charts_[static_cast<std::size_t>(Quantity::ROTATION)].add(
      steadyNanoseconds(), motion_->state == PatientMotion::OK && std::isfinite(rotation)
                               ? kDegrees * rotation
                               : std::numeric_limits<double>::quiet_NaN());
}

void TreatmentFeed::motionCb(const PatientMotion::ConstPtr& message)
{
  const std::int64_t time = steadyNanoseconds();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const bool measured = message->state == PatientMotion::OK;
  const auto& t = message->translation;
  const std::lock_guard<std::mutex> lock(mutex_);
  motion_ = *message;
  motion_arrival_ = time;
  exposures_.add(time, true);
  const auto add = [&](Quantity quantity, double value)
  { charts_[static_cast<std::size_t>(quantity)].add(time, std::isfinite(value) ? value : nan); };
  add(Quantity::DISPLACEMENT, measured ? 1e3 * Eigen::Vector3d(t.x, t.y, t.z).norm() : nan);
  add(Quantity::SIGMA, measured ? worstSigma(message->covariance) : nan);
  add(Quantity::DISAGREEMENT, measured ? message->disagreement : nan);
  add(Quantity::LATENCY, 1e3 * message->wall_time.toSec());
  noteRotation();
}

void TreatmentFeed::refinedCb(const RefinedPose::ConstPtr& message)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  refined_ = *message;
  refined_arrival_ = steadyNanoseconds();
  const double similarity = message->result.similarity_after;
  charts_[static_cast<std::size_t>(Quantity::SIMILARITY)].add(
      steadyNanoseconds(), std::isfinite(similarity) && message->result.status <= RefinementResult::CANCELLED
                               ? similarity
                               : std::numeric_limits<double>::quiet_NaN());
}

void TreatmentFeed::trackedCb(const TrackedRegion::ConstPtr& message, Tracker& tracker)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  tracker.view.state = message->state;
  tracker.view.fault = message->fault;
  tracker.view.correlation = message->correlation;
  tracker.view.arrival = steadyNanoseconds();
}

void TreatmentFeed::addTracker(const std::string& detector)
{
  auto tracker = std::make_unique<Tracker>();
  tracker->view.detector = detector;
  const boost::function<void(const TrackedRegion::ConstPtr&)> cb =
      [this, view = tracker.get()](const TrackedRegion::ConstPtr& message) { trackedCb(message, *view); };
  tracker->subscriber = nh_.subscribe<TrackedRegion>(detector + kTrackedRegion, 10, cb);
  const std::lock_guard<std::mutex> lock(mutex_);
  trackers_.emplace(detector, std::move(tracker));
}

std::vector<std::string> TreatmentFeed::look()
{
  std::vector<std::string> found;
  const std::string prefix = nh_.resolveName("x").substr(0, nh_.resolveName("x").size() - 1);
  for (const std::string& topic : topicsOf("xray_tracking_msgs/TrackedRegion"))
  {
    if (topic.rfind(prefix, 0) == 0 && topic.size() > prefix.size() + kTrackedRegion.size() &&
        topic.compare(topic.size() - kTrackedRegion.size(), kTrackedRegion.size(), kTrackedRegion) == 0)
    {
      const std::string detector = topic.substr(prefix.size(), topic.size() - prefix.size() - kTrackedRegion.size());
      // Only this thread adds to them.
      if (trackers_.count(detector) == 0)
      {
        addTracker(detector);
        found.push_back(detector);
      }
    }
  }
  const auto parameter = [&](const char* name, double fallback)
  {
    double value = fallback;
    nh_.getParam(std::string("motion_estimation/gate/") + name, value);
    return std::isfinite(value) && value > 0.0 ? value : fallback;
  };
  const double max_displacement = parameter("max_displacement", 3.0);
  const double max_rotation = kDegrees * parameter("max_rotation", 0.0524);
  const double max_sigma = parameter("max_sigma", 1.5);
  std::string mode;
  nh_.getParam("motion_estimation/refinement/mode", mode);
  const bool tracked_alone = mode.empty() || mode == "never";
  const double max_tracked_sigma = tracked_alone ? max_sigma : std::min(max_sigma, parameter("max_tracked_sigma", 0.5));

  const std::lock_guard<std::mutex> lock(mutex_);
  max_displacement_ = max_displacement;
  max_rotation_ = max_rotation;
  max_sigma_ = max_sigma;
  max_tracked_sigma_ = max_tracked_sigma;
  return found;
}
}  // namespace xray_tracking
