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
                                  std::function<std::string(const boost::shared_ptr<Message const>&)> store)
{
  const boost::function<void(const boost::shared_ptr<Message const>&)> callback =
      [this, store = std::move(store)](const boost::shared_ptr<Message const>& message)
  {
    std::string dropped;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      dropped = store(message);
    }
    wake_.notify_all();
    if (!dropped.empty())
    {
      ROS_WARN_STREAM_THROTTLE(1.0, pnh_.getNamespace() << " drops a message: " << dropped);
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
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    store_.emplace(names, static_cast<std::size_t>(parameters_.queue_size));
  }
  for (std::size_t i = 0; i < names.size(); ++i)
  {
    const auto now = [] { return nanosecondsFromTime(ros::Time::now()); };
    subscribeTo<sensor_msgs::CameraInfo>(names[i] + "/camera_info", [this, i, now](const auto& message)
                                         { return store_->addCameraInfo(i, message, now()); });
    subscribeTo<sensor_msgs::Image>(
        names[i] + "/image_raw", [this, i, now](const auto& message) { return store_->addImage(i, message, now()); });
  }
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
