#include "xray_tracking_registration/registration_ros.h"

#include <stdexcept>
#include <utility>

#include "processor_clock.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_registration/refinement_messages.h"

namespace xray_tracking
{
namespace
{
/// Intake, a request that is being worked on, a load, and one that tells others to wait.
constexpr std::uint32_t kThreads = 4;
/// Slices as thin as the pixels.
const PhantomCtOptions kPhantomCt{ { 200, 200, 200 }, { 1.0, 1.0, 1.0 }, 1.0 };
}  // namespace

RegistrationRos::RegistrationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh)
  : nh_(nh), pnh_(pnh), tf_listener_(tf_buffer_, nh), updater_(nh, pnh, pnh.getNamespace())
{
  nh_.setCallbackQueue(&queue_);
  pnh_.setCallbackQueue(&queue_);
  updater_.setHardwareID("none");
  updater_.add("registration", this, &RegistrationRos::diagnose);
  try
  {
    parameters_ = readRegistrationParameters(pnh_);
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
  }
  refined_pose_publisher_ = nh_.advertise<xray_tracking_msgs::RefinedPose>("refined_pose", 100);
  services_.push_back(pnh_.advertiseService("refine_pose", &RegistrationRos::refinePoseCb, this));
  services_.push_back(pnh_.advertiseService("load_volume", &RegistrationRos::loadVolumeCb, this));
  action_server_ = std::make_unique<ActionServer>(
      pnh_, "refine_pose", [this](GoalHandle goal) { goalCb(goal); }, [this](GoalHandle goal) { cancelCb(goal); },
      false);
  action_server_->start();
  timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });
  spinner_ = std::make_unique<ros::AsyncSpinner>(kThreads, &queue_);
  spinner_->start();
  worker_ = std::thread([this] { workOnGoals(); });
  loader_ = std::thread([this] { start(); });
}

RegistrationRos::~RegistrationRos()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  worker_.join();
  loader_.join();
  spinner_->stop();
}

void RegistrationRos::start()
{
  std::string ct_path;
  try
  {
    if (!configuration_fault_.empty())
    {
      throw std::invalid_argument(configuration_fault_);
    }
    setup_ = loadTreatmentSetup(parameters_.setup_file);
  }
  catch (const std::exception& error)
  {
    ROS_FATAL_STREAM(pnh_.getNamespace() << " is idle: " << error.what());
    const std::lock_guard<std::mutex> lock(mutex_);
    configuration_fault_ = volume_state_ = error.what();
    loading_ = false;
    return;
  }
  sequence_.emplace(setup_.targetCentre());
  const std::string fault = load(parameters_.source == "ct" ? setup_.ct_path : "");
  ROS_ERROR_STREAM_COND(!fault.empty(), "no registration: " << fault);
  subscribe();
}

template <typename Message>
void RegistrationRos::subscribeTo(const std::string& topic,
                                  std::function<void(const boost::shared_ptr<Message const>&)> handle)
{
  // roscpp links publisher and subscriber of one process twice if both come up at the same time.
  const boost::function<void(const boost::shared_ptr<Message const>&)> callback =
      [handle = std::move(handle),
       last = boost::weak_ptr<Message const>()](const boost::shared_ptr<Message const>& message) mutable
  {
    if (last.lock() != message)
    {
      last = message;
      handle(message);
    }
  };
  subscribers_.push_back(nh_.subscribe<Message>(topic, static_cast<std::uint32_t>(parameters_.queue_size), callback,
                                                nullptr, ros::TransportHints().tcpNoDelay()));
}

void RegistrationRos::subscribe()
{
  std::vector<std::string> names;
  for (const ProjectionGeometry& geometry : setup_.detectors)
  {
    names.push_back(geometry.name());
  }
  intakes_.resize(names.size());
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    store_.emplace(names, static_cast<std::size_t>(parameters_.queue_size));
  }
  for (std::size_t i = 0; i < names.size(); ++i)
  {
    subscribeTo<sensor_msgs::CameraInfo>(names[i] + "/camera_info",
                                         [this, i](const auto& message) { takeCameraInfo(i, message); });
    subscribeTo<sensor_msgs::Image>(names[i] + "/image_raw", [this, i](const auto& message) { takeImage(i, message); });
  }
}

void RegistrationRos::warnOfDropped(const std::string& why) const
{
  ROS_WARN_STREAM_THROTTLE(1.0, pnh_.getNamespace() << " drops a message: " << why);
}

void RegistrationRos::takeCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(camera_info->header.stamp);
  std::string dropped;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    dropped = store_->takeCameraInfo(detector, stamp_ns, nanosecondsFromTime(ros::Time::now()));
    if (dropped.empty())
    {
      store_->keepCameraInfo(detector, stamp_ns, camera_info);
    }
  }
  if (!dropped.empty())
  {
    warnOfDropped(dropped);
    return;
  }
  wake_.notify_all();
}

void RegistrationRos::takeImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(image->header.stamp);
  std::string dropped;
  std::size_t run = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    dropped = store_->takeImage(detector, stamp_ns, nanosecondsFromTime(ros::Time::now()));
    run = store_->run();
  }
  if (!dropped.empty())
  {
    warnOfDropped(dropped);
    return;
  }
  Intake& intake = intakes_[detector];
  if (intake.run != run)
  {
    intake.pixels.reset();
    intake.run = run;
  }
  // Here, while the exposure is tracked, and not when somebody waits for an answer.
  UsableImage seen = usableImageOf(image, setup_.intensity, intake.pixels);
  const bool own = seen.image.data != image->data.data();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    store_->keepImage(detector, stamp_ns, run, std::move(seen), own ? nullptr : image);
  }
  wake_.notify_all();
}

std::string RegistrationRos::load(const std::string& ct_path)
{
  const std::string what = ct_path.empty() ? "the CT of " + parameters_.source : ct_path;
  std::shared_ptr<const Registration> registration;
  std::string fault;
  try
  {
    registration = makeRegistration(ct_path);
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    loading_ = false;
    if (registration)
    {
      registration_ = registration;
      volume_state_ = what;
    }
    else if (!registration_)
    {
      volume_state_ = "no volume: " + fault;
    }
  }
  wake_.notify_all();
  ROS_INFO_STREAM_COND(registration, "ready to register " << what);
  return fault;
}

std::shared_ptr<const Registration> RegistrationRos::makeRegistration(const std::string& ct_path) const
{
  if (ct_path.empty() && parameters_.source == "ct")
  {
    throw std::invalid_argument("ct is absent in " + parameters_.setup_file +
                                ", expected the path of a CT (source: ct)");
  }
  const PatientCt ct = ct_path.empty() ? PatientCt{ NeckPhantom().sampleCt(kPhantomCt), CtContent::FULL }
                                       : readPatientCt(ct_path, setup_.ct_content);
  const VolumeGrid& grid = ct.volume.grid;
  std::optional<TargetMask> mask;
  if (parameters_.bodies == 2)
  {
    const TargetMaskOptions& options = parameters_.mask_options;
    mask = parameters_.mask == "bone" ? targetMaskOf(ct, setup_.target_box, options)
           : parameters_.mask == "box"
               ? targetMaskFromBox(grid, setup_.target_box, options)
               : targetMaskFromLabels(grid, readLabelMap(parameters_.label_map), parameters_.label, options);
    if (!parameters_.mask_file.empty())
    {
      writeTargetMask(*mask, parameters_.mask_file);
    }
  }
  return std::make_shared<const Registration>(bodiesOf(ct, mask), setup_.target_box, parameters_.options);
}
}  // namespace xray_tracking
