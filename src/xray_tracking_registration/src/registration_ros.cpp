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
/// Of a start from the last believed pose: half of what the vertebrae of a neck are apart [mm].
constexpr double kSameVertebra = 9.0;
constexpr double kShortly = 5.0;  // after a believed pose, nobody has been set up anew [s]
constexpr const char* kStopping = "the node is shutting down";

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
  worker_ = std::thread([this] { work(); });
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
  accepted_pose_ = setup_.room_from_patient;
  const std::string fault = load(parameters_.source == "ct" ? setup_.ct_path : "");
  ROS_ERROR_STREAM_COND(!fault.empty(), "no registration: " << fault);
  subscribe();
}

template <typename Message>
void RegistrationRos::subscribeTo(const std::string& topic,
                                  std::function<void(const boost::shared_ptr<Message const>&)> store)
{
  const boost::function<void(const boost::shared_ptr<Message const>&)> callback =
      [this, store = std::move(store)](const boost::shared_ptr<Message const>& message)
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      store(message);
    }
    wake_.notify_one();
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
    store_.emplace(names, static_cast<std::size_t>(parameters_.queue_size),
                   parameters_.method == RefinementMethod::REGISTRATION);
  }
  for (std::size_t i = 0; i < names.size(); ++i)
  {
    subscribeTo<sensor_msgs::CameraInfo>(names[i] + "/camera_info",
                                         [this, i](const auto& message) { store_->addCameraInfo(i, message); });
    subscribeTo<sensor_msgs::Image>(names[i] + "/image_raw",
                                    [this, i](const auto& message) { store_->addImage(i, message); });
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
      volume_is_new_ = true;
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

void RegistrationRos::work()
{
  const bool by_itself = parameters_.method == RefinementMethod::REGISTRATION;
  std::unique_lock<std::mutex> lock(mutex_);
  while (!stop_)
  {
    noteRestart();
    if (job_)
    {
      job_->running = true;
      cancel_ = false;
      lock.unlock();
      answerJob();
      lock.lock();
      continue;
    }
    std::optional<ExposureStore::Due> due;
    // Exposures wait for the first volume.
    if (by_itself && store_ && (registration_ || !loading_))
    {
      due = store_->next();
    }
    if (!due)
    {
      wake_.wait(lock);
      continue;
    }
    lock.unlock();
    answerExposure(*due);
    lock.lock();
  }
  if (job_)
  {
    const auto answer = std::exchange(job_, std::nullopt)->answer;
    lock.unlock();
    answer(resultMessage(RefinementResult::CANCELLED, kStopping));
  }
}

void RegistrationRos::answerExposure(const ExposureStore::Due& due)
{
  const ProcessorClock clock;
  const RefinementResult result = refineExposure(due);
  if (stop_)
  {
    return;
  }
  publishRefined(due.stamp, result, clock.seconds(), due.exposure.last_arrival);
  const std::lock_guard<std::mutex> lock(mutex_);
  last_result_ = result;
}

void RegistrationRos::publishRefined(const ros::Time& stamp, const RefinementResult& result, double cpu_seconds,
                                     const ros::SteadyTime& arrival)
{
  xray_tracking_msgs::RefinedPose refined;
  refined.header.stamp = last_refined_ = stamp;
  refined.header.frame_id = kRoomFrame;
  refined.method = methodName(parameters_.method);
  refined.result = result;
  refined.cpu_time = ros::Duration(cpu_seconds);
  refined.wall_time = ros::Duration((ros::SteadyTime::now() - arrival).toSec());
  refined_pose_publisher_.publish(refined);
  const bool success = result.status == RefinementResult::SUCCESS;
  ROS_WARN_STREAM_COND(!success, "the exposure at " << stamp << " is not refined: " << result.reason);
  const std::lock_guard<std::mutex> lock(mutex_);
  ++exposures_;
  refined_ += success ? 1 : 0;
}

void RegistrationRos::noteRestart()
{
  if (store_ && store_->takeRestart())
  {
    ROS_WARN_STREAM("exposures start again: forgetting the earlier ones");
    accepted_pose_ = setup_.room_from_patient;
    target_from_rest_ = RigidTransform::Identity();
    believed_pose_.reset();
    usable_pixels_.reset();
    last_refined_ = ros::Time();
  }
}

RegistrationRos::RefinementResult RegistrationRos::refineExposure(const ExposureStore::Due& due)
{
  if (!due.missing.empty())
  {
    return resultMessage(RefinementResult::NO_EXPOSURE, due.missing);
  }
  const std::shared_ptr<const Registration> registration = currentRegistration();
  if (!registration)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return resultMessage(RefinementResult::NO_VOLUME, volume_state_);
  }
  try
  {
    RegistrationRequest request =
        requestFor(due.exposure, Search::NEAR, usable_pixels_, [this](const RegistrationProgress&) { return !stop_; });
    request.room_from_patient = accepted_pose_;
    const RefinementResult result = run(*registration, request, due.stamp, false);
    if (result.status == RefinementResult::SUCCESS)
    {
      accepted_pose_ = rigidFromPoseMsg(result.pose.pose);
    }
    return result;
  }
  catch (const std::exception& error)
  {
    return resultMessage(RefinementResult::INVALID, error.what());
  }
}

std::shared_ptr<const Registration> RegistrationRos::currentRegistration()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (std::exchange(volume_is_new_, false))
  {
    target_from_rest_ = RigidTransform::Identity();
    believed_pose_.reset();
  }
  return registration_;
}

RegistrationRequest RegistrationRos::requestFor(const StoredExposure& exposure, Search search, UsablePixels& usable,
                                                const Progress& progress) const
{
  RegistrationRequest request;
  request.views = viewsOf(exposure, setup_, tf_buffer_);
  request.intensity = setup_.intensity;
  usable.apply(static_cast<std::int64_t>(exposure.images.front()->header.stamp.toNSec()), request);
  request.target_from_rest = target_from_rest_;
  const bool wide = search == Search::WIDE;
  request.search = search;
  request.max_translation_mm = wide ? parameters_.search_max_translation_mm : parameters_.max_translation_mm;
  request.max_rotation_rad = wide ? parameters_.search_max_rotation_rad : parameters_.max_rotation_rad;
  request.time_budget = std::chrono::duration<double>(parameters_.time_budget_s);
  request.progress = progress;
  return request;
}

RegistrationRos::RefinementResult RegistrationRos::run(const Registration& registration, RegistrationRequest request,
                                                       const std::optional<ros::Time>& stamp, bool unverified)
{
  const Eigen::Vector3d centre = setup_.targetCentre();
  if (stamp && believed_pose_ && !unverified)
  {
    // As doubles: what lies too far apart for a ros::Duration is to be no error.
    const double since = stamp->toSec() - believed_pose_->stamp.toSec();
    const double moved = (request.room_from_patient * centre - believed_pose_->room_from_patient * centre).norm();
    request.start_verified = since >= 0.0 && since <= kShortly && moved < kSameVertebra;
  }
  const RegistrationResult result = registration.run(request);
  if (result.status == RegistrationStatus::SUCCESS)
  {
    target_from_rest_ = result.target_from_rest;
    if (stamp)
    {
      believed_pose_ = BelievedPose{ result.room_from_patient, *stamp };
    }
  }
  return resultMessage(result, setup_.targetCentre());
}
}  // namespace xray_tracking
