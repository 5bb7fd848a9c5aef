#include "xray_tracking_detector_simulator/detector_simulator_ros.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <sensor_msgs/image_encodings.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_detector_simulator/simulator_parameters.h"

namespace xray_tracking
{
namespace
{
constexpr int kQueueSize = 4;         // exposures that a slow subscriber may lag behind
constexpr double kWarnPeriod = 10.0;  // [s]

std::unique_ptr<Anatomy> makeAnatomy(const SimulatorParameters& parameters, const TreatmentSetup& setup)
{
  if (parameters.source == "phantom")
  {
    return std::make_unique<PhantomAnatomy>();
  }
  if (setup.ct_path.empty())
  {
    throw std::invalid_argument("ct is absent in " + parameters.setup_file +
                                ", expected the path of a CT (source: ct)");
  }
  return std::make_unique<CtAnatomy>(readCtVolume(setup.ct_path, setup.ct_choice), setup.target_box);
}

double seconds(std::chrono::steady_clock::duration duration)
{
  return std::chrono::duration<double>(duration).count();
}
}  // namespace

DetectorSimulatorRos::DetectorSimulatorRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh),
    pnh_(pnh),
    truth_publisher_(nh_.advertise<geometry_msgs::PoseStamped>("patient_ground_truth", kQueueSize)),
    updater_(nh, pnh, pnh.getNamespace())
{
  updater_.setHardwareID("none");
  updater_.add("exposures", this, &DetectorSimulatorRos::produceDiagnostics);
  diagnostics_timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });
  start_service_ = pnh_.advertiseService("start", &DetectorSimulatorRos::onStart, this);
  worker_ = std::thread([this] { computing_.run_and_wait([this] { run(); }); });
}

DetectorSimulatorRos::~DetectorSimulatorRos()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  // Every loop on all cores that runs or is yet to come returns at once; what it leaves unfinished is not looked at.
  computing_.cancel();
  worker_.join();
}

void DetectorSimulatorRos::run()
{
  try
  {
    load();
    prepare(0);
    if (stopped())
    {
      return;
    }
    setState(State::READY);
    ROS_INFO("detector simulator: ready, %zu detectors, %s", detectors_.size(),
             exposures_ == 0 ? "endless" : (std::to_string(exposures_) + " exposures").c_str());
    if (waitForStart())
    {
      runExposures();
    }
  }
  catch (const std::exception& error)
  {
    if (stopped())
    {
      return;  // an error of what was left unfinished, if any
    }
    setState(State::FAILED, error.what());
    ROS_ERROR("detector simulator: no exposures: %s", error.what());
  }
}

void DetectorSimulatorRos::load()
{
  const SimulatorParameters parameters = readParameters(ParameterReader(pnh_));
  const TreatmentSetup setup = loadTreatmentSetup(parameters.setup_file);
  simulator_ = std::make_unique<DetectorSimulator>(setup, makeAnatomy(parameters, setup), parameters.motion,
                                                   parameters.image, static_cast<std::uint64_t>(parameters.seed));
  rate_ = parameters.rate;
  exposures_ = parameters.exposures;
  wait_for_start_ = parameters.wait_for_start;
  for (const ProjectionGeometry& geometry : setup.detectors)
  {
    Detector detector;
    detector.image_publisher = nh_.advertise<sensor_msgs::Image>(geometry.name() + "/image_raw", kQueueSize);
    detector.info_publisher = nh_.advertise<sensor_msgs::CameraInfo>(geometry.name() + "/camera_info", kQueueSize);
    detector.info = cameraInfoFromGeometry(geometry);
    detectors_.push_back(std::move(detector));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  asked_rate_ = rate_;
}

void DetectorSimulatorRos::prepare(int exposure)
{
  const Clock::time_point begin = Clock::now();
  images_.clear();
  for (Detector& detector : detectors_)
  {
    // A message is new for every exposure: subscribers in the same process keep it.
    const auto image = boost::make_shared<sensor_msgs::Image>();
    image->height = detector.info.height;
    image->width = detector.info.width;
    image->encoding = sensor_msgs::image_encodings::MONO16;
    image->step = image->width * static_cast<std::uint32_t>(sizeof(std::uint16_t));
    image->data.resize(static_cast<std::size_t>(image->step) * image->height);
    images_.emplace_back(static_cast<int>(image->height), static_cast<int>(image->width), CV_16UC1, image->data.data());
    detector.next_image = image;
  }
  simulator_->expose(exposure, images_);
  next_pose_ = simulator_->poses(exposure).room_from_target;
  // An estimate of the next exposure's time that follows slow ones at once.
  compute_time_ = std::max(Clock::now() - begin, compute_time_ * 4 / 5);
  const std::lock_guard<std::mutex> lock(mutex_);
  compute_seconds_ = seconds(Clock::now() - begin);
}

bool DetectorSimulatorRos::stopped()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return stop_;
}

bool DetectorSimulatorRos::waitForStart()
{
  std::unique_lock<std::mutex> lock(mutex_);
  while (!stop_ && !start_requested_ && (wait_for_start_ || !everyImageHasSubscriber()))
  {
    wake_.wait_for(lock, std::chrono::milliseconds(20));
  }
  if (!stop_)
  {
    state_ = State::RUNNING;
  }
  return !stop_;
}

bool DetectorSimulatorRos::everyImageHasSubscriber() const
{
  return std::all_of(detectors_.begin(), detectors_.end(),
                     [](const Detector& detector) { return detector.image_publisher.getNumSubscribers() > 0; });
}

void DetectorSimulatorRos::runExposures()
{
  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1.0 / rate_));
  Clock::time_point due = Clock::now();
  Clock::time_point last = due;
  for (int exposure = 0; exposures_ == 0 || exposure < exposures_; ++exposure)
  {
    if (exposure > 0)
    {
      // As late as is safe, so that those who work on the last exposure have the processor to themselves.
      if (!sleepUntil(due - compute_time_ * 3 / 2 - std::chrono::milliseconds(5)))
      {
        return;
      }
      prepare(exposure);
    }
    ros::Time stamp;
    if (!sleepUntil(due) || !takeStamp(stamp))
    {
      return;
    }
    const Clock::time_point now = Clock::now();
    last_stamp_ = stamp;
    publish();
    if (exposure > 0)
    {
      reportPace(seconds(now - last));
    }
    last = now;
    // Late exposures are not caught up with: the rate is a bound.
    due = std::max(due + period, now);
  }
  setState(State::DONE);
  ROS_INFO("detector simulator: all %d exposures are done", exposures_);
}

void DetectorSimulatorRos::publish()
{
  geometry_msgs::TransformStamped transform;
  transform.header.stamp = last_stamp_;
  transform.header.frame_id = kRoomFrame;
  transform.child_frame_id = kGroundTruthFrame;
  transform.transform = transformMsgFromRigid(next_pose_);
  broadcaster_.sendTransform(transform);

  const auto truth = boost::make_shared<geometry_msgs::PoseStamped>();
  truth->header = transform.header;
  truth->pose = poseMsgFromRigid(next_pose_);
  truth_publisher_.publish(truth);

  for (Detector& detector : detectors_)
  {
    const auto info = boost::make_shared<sensor_msgs::CameraInfo>(detector.info);
    info->header.stamp = last_stamp_;
    detector.next_image->header = info->header;
    detector.info_publisher.publish(info);
    // Handed over for good: in the same process subscribers get this very message.
    detector.image_publisher.publish(std::exchange(detector.next_image, nullptr));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  ++published_;
}

bool DetectorSimulatorRos::sleepUntil(Clock::time_point time)
{
  std::unique_lock<std::mutex> lock(mutex_);
  return !wake_.wait_until(lock, time, [this] { return stop_; });
}

bool DetectorSimulatorRos::takeStamp(ros::Time& stamp)
{
  while (true)
  {
    stamp = ros::Time::now();
    if (!stamp.isZero() && stamp != last_stamp_)
    {
      return true;
    }
    ROS_WARN_THROTTLE(
        kWarnPeriod,
        "detector simulator: waiting for the clock to go on: start what publishes /clock, or unset /use_sim_time");
    if (!sleepUntil(Clock::now() + std::chrono::milliseconds(5)))
    {
      return false;
    }
  }
}

void DetectorSimulatorRos::reportPace(double seconds_since_last)
{
  const double achieved = 1.0 / seconds_since_last;
  if (achieved < 0.9 * rate_)
  {
    ROS_WARN_THROTTLE(kWarnPeriod,
                      "detector simulator: %.2f exposures a second, %.2f asked for; one takes %.3f s: lower its rate",
                      achieved, rate_, seconds(compute_time_));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  achieved_rate_ = achieved;
}

void DetectorSimulatorRos::setState(State state, const std::string& reason)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  state_ = state;
  reason_ = reason;
}

bool DetectorSimulatorRos::onStart(std_srvs::Trigger::Request& /*request*/, std_srvs::Trigger::Response& response)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    response.success = state_ == State::READY;
    switch (state_)
    {
      case State::LOADING:
        response.message = "not ready: still loading";
        break;
      case State::READY:
        response.message = "started";
        start_requested_ = true;
        state_ = State::RUNNING;
        break;
      case State::RUNNING:
        response.message = "already running";
        break;
      case State::DONE:
        response.message = "all exposures are done";
        break;
      case State::FAILED:
        response.message = reason_;
        break;
    }
  }
  wake_.notify_all();
  return true;
}

void DetectorSimulatorRos::produceDiagnostics(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using diagnostic_msgs::DiagnosticStatus;
  const std::lock_guard<std::mutex> lock(mutex_);
  switch (state_)
  {
    case State::LOADING:
      status.summary(DiagnosticStatus::OK, "loading");
      break;
    case State::READY:
      status.summary(DiagnosticStatus::OK, "waiting for the start");
      break;
    case State::RUNNING:
      if (published_ > 1 && achieved_rate_ < 0.9 * asked_rate_)
      {
        status.summary(DiagnosticStatus::WARN, "slower than asked for: lower its rate");
      }
      else
      {
        status.summary(DiagnosticStatus::OK, "running");
      }
      break;
    case State::DONE:
      status.summary(DiagnosticStatus::OK, "done");
      break;
    case State::FAILED:
      status.summary(DiagnosticStatus::ERROR, reason_);
      break;
  }
  status.add("exposures", published_);
  status.add("rate asked for [Hz]", asked_rate_);
  status.add("rate achieved [Hz]", achieved_rate_);
  status.add("time of computing an exposure [s]", compute_seconds_);
}
}  // namespace xray_tracking
