#include "xray_tracking_registration/registration_ros.h"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <stdexcept>
#include <utility>

#include <std_msgs/String.h>

#include "processor_clock.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/image/attenuation.h"
#include "xray_tracking_core/plan/structure.h"
#include "xray_tracking_core/volume/data_folder.h"
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

/// The setup's target structure on the CT's grid, 1 inside.
CtVolume roiLabels(const TreatmentSetup& setup, const std::string& ct_path, const VolumeGrid& grid)
{
  if (!setup.target_structure || ct_path.empty())
  {
    throw std::invalid_argument("mask/from is roi, expected source: ct and a setup file with target: {rtstruct, roi}");
  }
  const Structure structure = Structure::read(*setup.target_structure);
  structure.requireOn(readCtFrame(ct_path, setup.ct_choice.series));
  return structure.labels(grid);
}

/// What a person can do, where the reason does not say it.
std::string adviceFor(std::uint8_t status)
{
  using Result = xray_tracking_msgs::RefinementResult;
  switch (status)
  {
    case Result::UNRELIABLE:
      return "; if it lasts, lay the overlay over the images: is it this patient, lying as planned?";
    case Result::TIMED_OUT:
      return "; if it lasts, raise time_budget, or give it processors";
    case Result::NO_VOLUME:
      return "; wait, or load a CT (load_volume)";
    case Result::NO_EXPOSURE:
      return "; look whether all detectors send images and camera_info with the same stamps";
    default:
      return "";
  }
}
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
    parameters_ = readRegistrationParameters(ParameterReader(pnh_));
  }
  catch (const std::exception& error)
  {
    configuration_fault_ = error.what();
  }
  refined_pose_publisher_ = nh_.advertise<xray_tracking_msgs::RefinedPose>("refined_pose", 100);
  volume_publisher_ = pnh_.advertise<std_msgs::String>("volume", 1, true);
  load_service_ = pnh_.advertiseService("load_volume", &RegistrationRos::loadVolumeCb, this);
  server_ = std::make_unique<RefinementServer>(
      pnh_, [this](const auto&... request) { return serve(request...); },
      [this]
      {
        if (ExposureIntake* exposures = intake())
        {
          exposures->wake();
        }
      });
  render_server_ =
      std::make_unique<RenderServer>(pnh_, tf_buffer_, [this](std::string& why) { return registration(why); });
  timer_ =
      nh_.createSteadyTimer(ros::WallDuration(1.0), [this](const ros::SteadyTimerEvent&) { updater_.force_update(); });
  spinner_ = std::make_unique<ros::AsyncSpinner>(kThreads, &queue_);
  spinner_->start();
  loader_ = std::thread([this] { start(); });
}

RegistrationRos::~RegistrationRos()
{
  server_->stop();
  loader_.join();
  render_server_.reset();
  spinner_->stop();
}

std::shared_ptr<const Registration> RegistrationRos::registration(std::string& why)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!registration_)
  {
    why = volume_state_;
  }
  return registration_;
}

ExposureIntake* RegistrationRos::intake()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return intake_.get();
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
  const std::string fault = loadFirst();
  ROS_ERROR_STREAM_COND(
      !fault.empty(),
      "no registration: " << fault << "; load a CT (load_volume), or mend the setup file and start again");
  auto exposures =
      std::make_unique<ExposureIntake>(nh_, pnh_.getNamespace(), setup_, tf_buffer_, parameters_.queue_size);
  const std::lock_guard<std::mutex> lock(mutex_);
  intake_ = std::move(exposures);
}

std::string RegistrationRos::load(const std::string& ct_path)
{
  const std::string what = ct_path.empty() ? "the CT of " + parameters_.source : ct_path;
  std::shared_ptr<const Registration> registration;
  try
  {
    registration = makeRegistration(ct_path);
  }
  catch (const std::exception& error)
  {
    return notLoaded(error.what());
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    loading_ = false;
    registration_ = registration;
    volume_state_ = what;
    last_result_.reset();  // says nothing of this one
  }
  std_msgs::String volume;
  volume.data = ct_path;
  volume_publisher_.publish(volume);
  ROS_INFO_STREAM("ready to register " << what);
  return "";
}

std::string RegistrationRos::notLoaded(const std::string& fault)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  loading_ = false;
  if (!registration_)
  {
    volume_state_ = "no volume: " + fault;
  }
  return fault;
}

std::string RegistrationRos::loadFirst()
{
  if (parameters_.keep_for_restart)
  {
    restart_file_.emplace(pnh_, "volume 1");
  }
  if (!restart_file_ || !restart_file_->succeeds() || !std::filesystem::exists(restart_file_->path()))
  {
    return load(parameters_.source == "ct" ? setup_.ct_path : "");
  }
  std::string asked;
  try
  {
    asked = restart_file_->read();
  }
  catch (const std::exception& error)
  {
    return notLoaded(std::string("the node has died, and which CT it was told to load is not known: ") + error.what());
  }
  ROS_WARN_STREAM(pnh_.getNamespace() << " has died and was started again; it loads the CT that it was told to: "
                                      << asked);
  return loadAsked(asked);
}

BodyModel RegistrationRos::readBodies(const std::string& ct_path) const
{
  if (ct_path.empty() && parameters_.source == "ct")
  {
    throw std::invalid_argument("ct is absent in " + parameters_.setup_file +
                                ", expected the path of a CT (source: ct)");
  }
  const PatientCt ct = ct_path.empty() ? PatientCt{ NeckPhantom().sampleCt(kPhantomCt), CtContent::FULL }
                                       : readPatientCt(ct_path, setup_.ct_content, setup_.ct_choice);
  const VolumeGrid& grid = ct.volume.grid;
  std::optional<TargetMask> mask;
  if (parameters_.bodies == 2)
  {
    const TargetMaskOptions& options = parameters_.mask_options;
    mask = parameters_.mask == "bone"  ? targetMaskOf(ct, setup_.target_box, options)
           : parameters_.mask == "box" ? targetMaskFromBox(grid, setup_.target_box, options)
           : parameters_.mask == "roi"
               ? targetMaskFromLabels(grid, roiLabels(setup_, ct_path, grid), 1, options)
               : targetMaskFromLabels(grid, readLabelMap(parameters_.label_map, setup_.ct_choice), parameters_.label,
                                      options);
    if (!parameters_.mask_file.empty())
    {
      writeTargetMask(*mask, parameters_.mask_file);
    }
  }
  return bodiesOf(ct, mask);
}

std::shared_ptr<const Registration> RegistrationRos::makeRegistration(const std::string& ct_path) const
{
  // The CT is gone by then: a large one takes as much memory as its models.
  const BodyModel bodies = readBodies(ct_path);
  return std::make_shared<const Registration>(bodies, setup_.target_box, parameters_.options);
}

RegistrationRos::RefinementResult RegistrationRos::serve(const RefinementRequest& request, const Progress& progress,
                                                         const ros::SteadyTime& arrival)
{
  const ProcessorClock clock;
  std::int64_t stamp_ns = nanosecondsFromTime(request.stamp);
  RefinementResult result = refine(request, progress, stamp_ns);
  if (request.images.empty() && stamp_ns != 0 && !server_->stopped())
  {
    publishRefined(stamp_ns, result, clock.seconds(), arrival);
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  last_result_ = result;
  return result;
}

namespace
{
/// Once: what stands for a figure that the setup does not give.
void sayAirCounts(const RegistrationRequest& request)
{
  if (request.intensity.kind != IntensityModel::Kind::COUNTS || request.intensity.air_counts)
  {
    return;
  }
  std::ostringstream views;
  for (const RegistrationView& view : request.views)
  {
    views << ", " << airCounts(view.image, request.intensity) << " of " << view.geometry.name();
  }
  ROS_INFO_STREAM_ONCE("intensity.air_counts is not given: estimated in each image as its brightest pixel"
                       << views.str());
}
}  // namespace

RegistrationRos::RefinementResult RegistrationRos::refine(const RefinementRequest& message, const Progress& progress,
                                                          std::int64_t& stamp_ns)
{
  std::shared_ptr<const Registration> registration;
  ExposureIntake* exposures = nullptr;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!registration_)
    {
      return resultMessage(RefinementResult::NO_VOLUME, volume_state_);
    }
    registration = registration_;
    exposures = intake_.get();
  }
  try
  {
    const bool kept = message.images.empty();
    StoredExposure views;
    if (!kept)
    {
      views = exposureOf(message, setup_);
    }
    else
    {
      std::string reason = "the node does not listen for exposures yet";
      std::optional<FoundExposure> found;
      if (exposures != nullptr)
      {
        found = exposures->find(
            stamp_ns, message.without, [this] { return server_->brokenOff(); }, reason);
      }
      if (!found)
      {
        return resultMessage(server_->brokenOff() ? RefinementResult::CANCELLED : RefinementResult::NO_EXPOSURE,
                             reason);
      }
      if (run_ != found->run)
      {
        ROS_WARN_STREAM_THROTTLE(1.0,
                                 "exposures start again: forgetting the earlier ones; unless a bag is played again, "
                                 "look at the detectors' and this computer's clocks");
        run_ = found->run;
        sequence_->forget();
        published_.clear();
      }
      stamp_ns = found->stamp_ns;
      views = std::move(found->views);
    }
    RegistrationRequest request = requestFor(views, message, progress);
    sayAirCounts(request);
    applyRequest(message, setup_, request);
    sequence_->setRegistration(std::move(registration));
    return resultMessage(sequence_->run(std::move(request), kept ? std::optional<std::int64_t>(stamp_ns) : std::nullopt,
                                        message.unverified != 0),
                         setup_.targetCentre());
  }
  catch (const std::exception& error)
  {
    return resultMessage(RefinementResult::INVALID, error.what());
  }
}

RegistrationRequest RegistrationRos::requestFor(const StoredExposure& exposure, const RefinementRequest& message,
                                                const Progress& progress) const
{
  RegistrationRequest request;
  request.views = viewsOf(exposure, setup_, message.without, tf_buffer_);
  request.intensity = setup_.intensity;
  request.search = searchOf(message);
  const bool wide = request.search == Search::WIDE;
  request.max_translation_mm = wide ? parameters_.search_max_translation_mm : parameters_.max_translation_mm;
  request.max_rotation_rad = wide ? parameters_.search_max_rotation_rad : parameters_.max_rotation_rad;
  request.time_budget = std::chrono::duration<double>(parameters_.time_budget_s);
  request.progress = progress;
  return request;
}

void RegistrationRos::publishRefined(std::int64_t stamp_ns, const RefinementResult& result, double cpu_seconds,
                                     const ros::SteadyTime& arrival)
{
  // Each exposure once, whoever asks. One that was not found may come yet.
  const bool found = result.status != RefinementResult::NO_EXPOSURE;
  if (std::find(published_.begin(), published_.end(), stamp_ns) != published_.end())
  {
    return;
  }
  if (found)
  {
    published_.push_back(stamp_ns);
  }
  if (published_.size() > static_cast<std::size_t>(parameters_.queue_size))
  {
    published_.pop_front();
  }
  xray_tracking_msgs::RefinedPose refined;
  refined.header.stamp = timeFromNanoseconds(stamp_ns);
  refined.header.frame_id = kRoomFrame;
  refined.result = result;
  refined.cpu_time = ros::Duration(cpu_seconds);
  refined.wall_time = ros::Duration((ros::SteadyTime::now() - arrival).toSec());
  refined_pose_publisher_.publish(refined);
  const bool success = result.status == RefinementResult::SUCCESS;
  if (!success)
  {
    ROS_WARN_STREAM_THROTTLE(1.0, "the exposure at " << refined.header.stamp << " is not refined: " << result.reason
                                                     << adviceFor(result.status));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  exposures_ += found ? 1 : 0;
  refined_ += success ? 1 : 0;
}

std::string RegistrationRos::loadAsked(const std::string& ct_path)
{
  try
  {
    return load(ctBelow(ct_path, parameters_.data_folder.empty() ? usualDataFolder(setup_, parameters_.setup_file)
                                                                 : parameters_.data_folder));
  }
  catch (const std::exception& error)
  {
    return notLoaded(error.what());
  }
}

bool RegistrationRos::loadVolumeCb(xray_tracking_msgs::LoadVolume::Request& request,
                                   xray_tracking_msgs::LoadVolume::Response& response)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!configuration_fault_.empty())
    {
      response.message = "the node is idle: " + configuration_fault_;
    }
    else if (request.path.empty())
    {
      response.message = "path is empty, expected a volume file or a folder with a DICOM series";
    }
    else if (loading_)
    {
      response.message = "busy: another volume is being loaded";
    }
    if (!response.message.empty())
    {
      return true;
    }
    loading_ = true;
  }
  response.message = loadAsked(request.path);
  response.success = response.message.empty();
  if (!response.success)
  {
    return true;
  }
  response.message = "loaded";
  try
  {
    if (restart_file_)
    {
      restart_file_->write(request.path);
    }
  }
  catch (const std::exception& error)
  {
    response.message += "; not kept for when the node dies: " + std::string(error.what());
    ROS_WARN_STREAM(response.message << "; load it again then");
  }
  return true;
}

void RegistrationRos::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using diagnostic_msgs::DiagnosticStatus;
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!registration_)
  {
    status.summary(loading_ ? DiagnosticStatus::WARN : DiagnosticStatus::ERROR, volume_state_);
  }
  else if (last_result_ && last_result_->status != RefinementResult::SUCCESS)
  {
    status.summary(DiagnosticStatus::WARN,
                   "the last refinement: " + last_result_->reason + adviceFor(last_result_->status));
  }
  else
  {
    status.summary(DiagnosticStatus::OK, server_->busy() ? "at work on a request" : "ready");
  }
  status.add("volume", volume_state_);
  status.add("memory of the volume [MB]", registration_ ? registration_->memory() / 1000000 : 0);
  status.add("exposures kept", intake_ ? intake_->size() : 0);
  status.add("exposures answered", exposures_);
  status.add("exposures refined", refined_);
  if (last_result_)
  {
    status.add("similarity of the last refinement", last_result_->similarity_after);
    status.add("time of the last refinement [s]", last_result_->time.toSec());
  }
}
}  // namespace xray_tracking
