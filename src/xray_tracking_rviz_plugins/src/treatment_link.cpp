#include "treatment_link.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include <ros/master.h>
#include <std_msgs/Header.h>
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
/// A registration that is at another request is asked again for so long [ns].
constexpr std::int64_t kBusy = 3 * kSecond;
constexpr std::int64_t kHoldAgain = kSecond / 2;  ///< after which a hold that is not confirmed is asked for again [ns]
const std::string kTrackedRegion = "/tracked_region";

TreatmentLink::Charts emptyCharts()
{
  const RecentValues<double> none(kMinute, kMostValues);
  return { none, none, none, none, none, none };
}

const char* statusWords(std::uint8_t status)
{
  static const char* const kWords[] = { "believed",    "not believed", "ran out of time",  "cancelled",
                                        "bad request", "no CT loaded", "no such exposure", "busy" };
  return status < 8 ? kWords[status] : "unknown status";
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

TreatmentLink::TreatmentLink(const ros::NodeHandle& nh)
  : nh_(nh), exposures_(5 * kSecond, 1000), charts_(emptyCharts()), lights_(kMinute, kMostValues)
{
  nh_.setCallbackQueue(&queue_);
  gate_subscriber_ = nh_.subscribe("beam_gate", 1, &TreatmentLink::gateCb, this, ros::TransportHints().tcpNoDelay());
  motion_subscriber_ = nh_.subscribe("patient_motion", 100, &TreatmentLink::motionCb, this);
  refined_subscriber_ = nh_.subscribe("refined_pose", 100, &TreatmentLink::refinedCb, this);
  const boost::function<void(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr&)> pose_cb =
      [this](const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    pose_ = message->pose.pose;
  };
  pose_subscriber_ = nh_.subscribe<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 1, pose_cb);
  heartbeat_ = nh_.advertise<std_msgs::Header>("operator_present", 1);

  hold_ = std::make_unique<ServiceCaller<std_srvs::SetBool>>(
      nh_, "motion_estimation/hold_beam",
      [this](const std::optional<std_srvs::SetBool::Response>& response, const std::string& why)
      { end(Command::HOLD, response && response->success, response ? response->message : why); });
  restart_ = std::make_unique<ServiceCaller<Trigger>>(
      nh_, "motion_estimation/restart",
      [this](const std::optional<Trigger::Response>& response, const std::string& why)
      { end(Command::RESET, response && response->success, response ? response->message : why); });
  refine_next_ = std::make_unique<ServiceCaller<Trigger>>(
      nh_, "motion_estimation/refine", [](const std::optional<Trigger::Response>&, const std::string&) {});
  load_volume_ = std::make_unique<ServiceCaller<xray_tracking_msgs::LoadVolume>>(
      nh_, "registration/load_volume",
      [this](const std::optional<xray_tracking_msgs::LoadVolume::Response>& response, const std::string& why)
      { end(Command::LOAD_CT, response && response->success, response ? response->message : why); });
  spinner_ = std::make_unique<ros::AsyncSpinner>(1, &queue_);
  spinner_->start();
  watcher_ = std::thread([this] { watch(); });
}

TreatmentLink::~TreatmentLink()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  stopping_.notify_all();
  watcher_.join();
  spinner_->stop();
  for (auto& [name, tracker] : trackers_)
  {
    tracker->retrain->shutdown();
    tracker->reset->shutdown();
  }
  hold_->shutdown();
  restart_->shutdown();
  refine_next_->shutdown();
  load_volume_->shutdown();
  refiner_.reset();
}

std::int64_t TreatmentLink::now()
{
  return static_cast<std::int64_t>(ros::SteadyTime::now().toNSec());
}

TreatmentView TreatmentLink::view() const
{
  const bool simulated = ros::Time::isSimTime();
  const std::lock_guard<std::mutex> lock(mutex_);
  TreatmentView view;
  view.gate = gate_;
  view.gate_view = gateView(gate_, now(), simulated ? std::nullopt : std::optional<ros::Time>(ros::Time::now()));
  view.motion = motion_;
  view.refined = refined_;
  view.motion_arrival = motion_arrival_;
  view.refined_arrival = refined_arrival_;
  view.registration = registration_;
  const auto& exposures = exposures_.entries();
  const auto recent = std::count_if(exposures.begin(), exposures.end(),
                                    [t = now()](const auto& e) { return e.time >= t - 5 * kSecond; });
  view.rate = static_cast<double>(recent) / 5.0;
  for (const auto& [name, tracker] : trackers_)
  {
    view.trackers.push_back(tracker->view);
  }
  view.max_displacement = max_displacement_;
  view.max_rotation = max_rotation_;
  view.max_sigma = max_sigma_;
  view.commands = commands_;
  if (simulated && ros::Time::now().isZero())
  {
    view.frozen_clock = "simulated time, but nothing on /clock: start the playback, or set /use_sim_time to false";
  }
  return view;
}

TreatmentLink::Charts TreatmentLink::charts() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return charts_;
}

TreatmentLink::Lights TreatmentLink::lights() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return lights_;
}

void TreatmentLink::gateCb(const BeamGate::ConstPtr& message)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  const bool new_exposure = !gate_ || gate_->message.exposure != message->exposure;
  gate_ = HeardGate{ *message, now() };
  if (new_exposure && !message->exposure.isZero() && std::isfinite(message->rotation))
  {
    charts_[static_cast<std::size_t>(Quantity::ROTATION)].add(now(), kDegrees * message->rotation);
  }
  if (hold_asked_ && *hold_asked_ == (message->reason == BeamGate::HELD))
  {
    hold_asked_.reset();
  }
}

void TreatmentLink::motionCb(const PatientMotion::ConstPtr& message)
{
  const std::int64_t time = now();
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
}

void TreatmentLink::refinedCb(const RefinedPose::ConstPtr& message)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  refined_ = *message;
  refined_arrival_ = now();
  const double similarity = message->result.similarity_after;
  charts_[static_cast<std::size_t>(Quantity::SIMILARITY)].add(
      now(), std::isfinite(similarity) && message->result.status <= RefinementResult::CANCELLED
                 ? similarity
                 : std::numeric_limits<double>::quiet_NaN());
}

void TreatmentLink::trackedCb(const TrackedRegion::ConstPtr& message, Tracker& tracker)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  tracker.view.state = message->state;
  tracker.view.fault = message->fault;
  tracker.view.correlation = message->correlation;
  tracker.view.arrival = now();
}

void TreatmentLink::addTracker(const std::string& detector)
{
  auto tracker = std::make_unique<Tracker>();
  tracker->view.detector = detector;
  tracker->retrain = std::make_unique<ServiceCaller<Trigger>>(
      nh_, detector + "/retrain",
      [this, detector](const std::optional<Trigger::Response>& response, const std::string& why)
      { trackerAnswered(Command::TRAIN, detector, response, why); });
  tracker->reset = std::make_unique<ServiceCaller<Trigger>>(
      nh_, detector + "/reset",
      [this, detector](const std::optional<Trigger::Response>& response, const std::string& why)
      { trackerAnswered(Command::RESET, detector, response, why); });
  const boost::function<void(const TrackedRegion::ConstPtr&)> cb =
      [this, view = tracker.get()](const TrackedRegion::ConstPtr& message) { trackedCb(message, *view); };
  tracker->subscriber = nh_.subscribe<TrackedRegion>(detector + kTrackedRegion, 10, cb);
  const std::lock_guard<std::mutex> lock(mutex_);
  trackers_.emplace(detector, std::move(tracker));
}

void TreatmentLink::watch()
{
  std::unique_lock<std::mutex> lock(mutex_);
  while (!stop_)
  {
    lock.unlock();
    watchOnce();
    lock.lock();
    stopping_.wait_for(lock, std::chrono::seconds(1), [this] { return stop_; });
  }
}

void TreatmentLink::watchOnce()
{
  if (!refiner_ && ros::Time::isValid())
  {
    auto made = std::make_unique<Client>(nh_, "registration/refine_pose", false);
    const std::lock_guard<std::mutex> lock(mutex_);
    refiner_ = std::move(made);
  }
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
      }
    }
  }
  const auto missing = [&](const std::vector<std::string>& services)
  {
    std::string names;
    for (const std::string& service : services)
    {
      if (!ros::service::exists(nh_.resolveName(service), false))
      {
        names += (names.empty() ? "no service " : ", ") + service;
      }
    }
    return names;
  };
  std::vector<std::string> retrain, reset{ "motion_estimation/restart" };
  for (const auto& [name, tracker] : trackers_)
  {
    retrain.push_back(name + "/retrain");
    reset.push_back(name + "/reset");
  }
  std::array<std::string, kCommands> wants;
  wants[static_cast<std::size_t>(Command::HOLD)] = missing({ "motion_estimation/hold_beam" });
  wants[static_cast<std::size_t>(Command::TRAIN)] = retrain.empty() ? "no tracker is running" : missing(retrain);
  wants[static_cast<std::size_t>(Command::RESET)] = missing(reset);
  wants[static_cast<std::size_t>(Command::LOAD_CT)] = missing({ "registration/load_volume" });
  const bool registration = wants[static_cast<std::size_t>(Command::LOAD_CT)].empty();
  wants[static_cast<std::size_t>(Command::REFINE)] =
      refiner_ && refiner_->isServerConnected() && registration ? "" : "the registration is not running";

  const auto parameter = [&](const char* name, double fallback)
  {
    double value = fallback;
    nh_.getParam(std::string("motion_estimation/gate/") + name, value);
    return std::isfinite(value) && value > 0.0 ? value : fallback;
  };
  const double max_displacement = parameter("max_displacement", 3.0);
  const double max_rotation = kDegrees * parameter("max_rotation", 0.0524);
  const double max_sigma = parameter("max_sigma", 1.5);

  const std::lock_guard<std::mutex> lock(mutex_);
  if (command(Command::REFINE).busy && !wants[static_cast<std::size_t>(Command::REFINE)].empty())
  {
    command(Command::REFINE).busy = send_again_ = false;  // nobody will answer
    command(Command::REFINE).failed = true;
  }
  registration_ = registration;
  max_displacement_ = max_displacement;
  max_rotation_ = max_rotation;
  max_sigma_ = max_sigma;
  for (std::size_t i = 0; i < kCommands; ++i)
  {
    CommandState& state = commands_[i];
    const bool told = !state.offered && !state.failed && !state.busy;  // what is missing
    state.offered = wants[i].empty();
    if (!state.offered && !state.busy)
    {
      state.text = wants[i];
    }
    else if (told)
    {
      state.text.clear();
    }
  }
}

void TreatmentLink::beat()
{
  bool again = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    again = std::exchange(send_again_, false);
    const GateLight light =
        gateView(gate_, now(), ros::Time::isSimTime() ? std::nullopt : std::optional<ros::Time>(ros::Time::now()))
            .light;
    if (lights_.entries().empty() || lights_.entries().back().value != light)
    {
      lights_.add(now(), light);
    }
    if (hold_asked_.value_or(false))
    {
      // Until it is confirmed: motion estimation may only be starting.
      if (!command(Command::HOLD).busy && now() - hold_tried_ > kHoldAgain)
      {
        hold_tried_ = now();
        std_srvs::SetBool::Request request;
        request.data = 1U;
        hold_->call(request);
      }
      return;
    }
  }
  std_msgs::Header header;
  header.stamp = ros::Time::now();
  header.frame_id = ros::this_node::getName();
  heartbeat_.publish(header);
  if (again)
  {
    sendGoal();
  }
}

void TreatmentLink::begin(Command which, const std::string& text)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  CommandState& state = command(which);
  state.busy = true;
  state.failed = false;
  state.text = text;
}

void TreatmentLink::end(Command which, bool success, const std::string& text)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  CommandState& state = command(which);
  state.busy = false;
  state.failed = !success;
  state.text = text;
  if (which == Command::HOLD && !success && hold_asked_ == false)
  {
    hold_asked_.reset();
  }
}

void TreatmentLink::hold(bool on)
{
  begin(Command::HOLD, on ? "holding ..." : "releasing ...");
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    hold_asked_ = on;
    hold_tried_ = now();
  }
  std_srvs::SetBool::Request request;
  request.data = static_cast<std::uint8_t>(on);
  if (!hold_->call(request))
  {
    end(Command::HOLD, false, "motion_estimation does not answer an earlier call");
  }
}

void TreatmentLink::askTrackers(Command which)
{
  std::vector<ServiceCaller<Trigger>*> callers;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (command(which).busy)
    {
      return;
    }
    tracker_faults_.clear();
    for (const auto& [name, tracker] : trackers_)
    {
      callers.push_back(which == Command::TRAIN ? tracker->retrain.get() : tracker->reset.get());
    }
    waiting_for_ = static_cast<int>(callers.size());
  }
  begin(which, which == Command::TRAIN ? "learning the templates at the next exposure ..." : "resetting ...");
  if (callers.empty())
  {
    end(which, false, "no tracker is running");
  }
  for (ServiceCaller<Trigger>* caller : callers)
  {
    if (!caller->call(Trigger::Request()))
    {
      trackerAnswered(which, "a tracker", std::nullopt, "does not answer an earlier call");
    }
  }
}

void TreatmentLink::trackerAnswered(Command which, const std::string& detector,
                                    const std::optional<Trigger::Response>& response, const std::string& why)
{
  std::string faults;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!response || !response->success)
    {
      tracker_faults_ += (tracker_faults_.empty() ? "" : "; ") + detector + ": " + (response ? response->message : why);
    }
    if (--waiting_for_ > 0)
    {
      return;
    }
    faults = tracker_faults_;
  }
  if (which == Command::RESET && faults.empty())
  {
    // After the templates: those that motion estimation does not know of would be doubted.
    if (restart_->call(Trigger::Request()))
    {
      return;
    }
    faults = "motion_estimation does not answer an earlier call";
  }
  end(which, faults.empty(), faults.empty() ? "all templates are learnt" : faults);
}

void TreatmentLink::train()
{
  askTrackers(Command::TRAIN);
}

void TreatmentLink::reset()
{
  askTrackers(Command::RESET);
}

void TreatmentLink::loadCt(const std::string& path)
{
  begin(Command::LOAD_CT, "loading " + path + " ...");
  xray_tracking_msgs::LoadVolume::Request request;
  request.path = path;
  if (!load_volume_->call(request))
  {
    end(Command::LOAD_CT, false, "the registration is still loading another CT");
  }
}

void TreatmentLink::refine()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (command(Command::REFINE).busy)
    {
      return;
    }
    refine_began_ = now();
  }
  Client* const client = refiner();
  if (client == nullptr || !client->isServerConnected())
  {
    end(Command::REFINE, false, "the registration is not running");
    return;
  }
  begin(Command::REFINE, "asked ...");
  sendGoal();
}

void TreatmentLink::sendGoal()
{
  xray_tracking_msgs::RefinePoseGoal goal;
  goal.request.seed.orientation.w = 1.0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!command(Command::REFINE).busy)
    {
      return;  // cancelled meanwhile
    }
    if (!pose_)
    {
      CommandState& state = command(Command::REFINE);
      state.busy = false;
      state.failed = true;
      state.text = "nothing on patient_pose to start from so far: reset, or align by hand";
      return;
    }
    goal.request.seed = *pose_;
  }
  refiner()->sendGoal(
      goal,
      [this](const actionlib::SimpleClientGoalState& state, const xray_tracking_msgs::RefinePoseResultConstPtr& result)
      { refineDone(state, result); },
      Client::SimpleActiveCallback(),
      [this](const xray_tracking_msgs::RefinePoseFeedbackConstPtr& feedback)
      {
        std::ostringstream text;
        text.precision(2);
        text << "level " << feedback->level + 1 << ", step " << feedback->iteration << ", similarity " << std::fixed
             << feedback->similarity;
        const std::lock_guard<std::mutex> lock(mutex_);
        if (command(Command::REFINE).busy)
        {
          command(Command::REFINE).text = text.str();
        }
      });
}

void TreatmentLink::refineDone(const actionlib::SimpleClientGoalState& state,
                               const xray_tracking_msgs::RefinePoseResultConstPtr& result)
{
  if (!result)
  {
    end(Command::REFINE, false, "the registration gave no result: " + state.getText());
    return;
  }
  const RefinementResult& found = result->result;
  if (found.status == RefinementResult::BUSY)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (now() - refine_began_ < kBusy)
    {
      command(Command::REFINE).text = "waiting for the registration, which is at an earlier exposure ...";
      send_again_ = true;
      return;
    }
  }
  std::ostringstream text;
  text.precision(2);
  text << std::fixed << statusWords(found.status);
  if (found.status <= RefinementResult::CANCELLED)
  {
    text << ", probability " << found.probability << ", similarity " << found.similarity_after << ", "
         << found.time.toSec() << " s";
  }
  if (found.status != RefinementResult::SUCCESS)
  {
    text << ": " << found.reason;
  }
  else
  {
    refine_next_->call(Trigger::Request());
  }
  end(Command::REFINE, found.status == RefinementResult::SUCCESS, text.str());
}

void TreatmentLink::cancelRefinement()
{
  bool waiting = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting = std::exchange(send_again_, false);
    if (!command(Command::REFINE).busy)
    {
      return;
    }
  }
  if (waiting)
  {
    end(Command::REFINE, false, "cancelled");
    return;
  }
  refiner()->cancelGoal();
}
}  // namespace xray_tracking
