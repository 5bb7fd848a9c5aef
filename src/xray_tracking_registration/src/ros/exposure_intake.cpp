#include "xray_tracking_registration/exposure_intake.h"

#include <chrono>
#include <sstream>
#include <utility>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_registration/refinement_messages.h"

namespace xray_tracking
{
namespace
{
/// Who tracks may ask about an exposure before all of its messages are here.
constexpr std::chrono::milliseconds kArrivalTime(500);

std::vector<std::string> namesOf(const std::vector<ProjectionGeometry>& detectors)
{
  std::vector<std::string> names;
  for (const ProjectionGeometry& detector : detectors)
  {
    names.push_back(detector.name());
  }
  return names;
}
}  // namespace

ExposureIntake::ExposureIntake(const ros::NodeHandle& nh, const std::string& name, const TreatmentSetup& setup,
                               const tf2_ros::Buffer& tf_buffer, int capacity)
  : nh_(nh),
    name_(name),
    intensity_(setup.intensity),
    tf_buffer_(tf_buffer),
    capacity_(capacity),
    store_(namesOf(setup.detectors), static_cast<std::size_t>(capacity))
{
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    detectors_.push_back({ detector, {}, 0 });
  }
  for (std::size_t i = 0; i < setup.detectors.size(); ++i)
  {
    const std::string& detector = setup.detectors[i].name();
    subscribeTo<sensor_msgs::CameraInfo>(detector + "/camera_info",
                                         [this, i](const auto& message) { takeCameraInfo(i, message); });
    subscribeTo<sensor_msgs::Image>(detector + "/image_raw", [this, i](const auto& message) { takeImage(i, message); });
  }
}

template <typename Message>
void ExposureIntake::subscribeTo(const std::string& topic,
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
  subscribers_.push_back(nh_.subscribe<Message>(topic, static_cast<std::uint32_t>(capacity_), callback, nullptr,
                                                ros::TransportHints().tcpNoDelay()));
}

void ExposureIntake::warnOfDropped(const std::string& why) const
{
  ROS_WARN_STREAM_THROTTLE(1.0, name_ << " drops a message: " << why << "; look at the detectors' drivers and clocks");
}

void ExposureIntake::takeCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(camera_info->header.stamp);
  std::optional<ProjectionGeometry> geometry;
  try
  {
    geometry = geometryOf(detectors_[detector].setup, *camera_info, tf_buffer_);
  }
  catch (const std::exception&)
  {
    // Whoever asks is told, if it still is so.
  }
  std::string dropped;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    dropped = store_.takeCameraInfo(detector, stamp_ns, nanosecondsFromTime(ros::Time::now()));
    if (dropped.empty())
    {
      store_.keepCameraInfo(detector, stamp_ns, camera_info, std::move(geometry));
    }
  }
  if (!dropped.empty())
  {
    warnOfDropped(dropped);
    return;
  }
  changed_.notify_all();
}

void ExposureIntake::takeImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(image->header.stamp);
  std::string dropped;
  std::size_t run = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    dropped = store_.takeImage(detector, stamp_ns, nanosecondsFromTime(ros::Time::now()));
    run = store_.run();
  }
  if (!dropped.empty())
  {
    warnOfDropped(dropped);
    return;
  }
  Detector& own = detectors_[detector];
  if (own.run != run)
  {
    own.pixels.reset();
    own.run = run;
  }
  // Here, while the exposure is tracked, and not when somebody waits for an answer.
  UsableImage seen = usableImageOf(image, intensity_, own.pixels);
  const bool copied = seen.image.data != image->data.data();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    store_.keepImage(detector, stamp_ns, run, std::move(seen), copied ? nullptr : image);
  }
  changed_.notify_all();
}

std::optional<FoundExposure> ExposureIntake::find(std::int64_t stamp_ns, const std::vector<std::string>& without,
                                                  const std::function<bool()>& broken_off, std::string& reason)
{
  std::unique_lock<std::mutex> lock(mutex_);
  const StoredExposure* stored = nullptr;
  const auto complete = [&]
  {
    stored = store_.find(stamp_ns, without);
    return stored != nullptr && store_.missingView(*stored, without).empty();
  };
  if (changed_.wait_for(lock, kArrivalTime, [&] { return broken_off() || complete(); }) && complete())
  {
    return FoundExposure{ stamp_ns, store_.run(), *stored };
  }
  reason = whyNone(stamp_ns, stored, without);
  return std::nullopt;
}

std::string ExposureIntake::whyNone(std::int64_t stamp_ns, const StoredExposure* stored,
                                    const std::vector<std::string>& without) const
{
  std::ostringstream reason;
  if (stored != nullptr)
  {
    reason << "the exposure at " << timeFromNanoseconds(stamp_ns)
           << " lacks a view: " << store_.missingView(*stored, without);
  }
  else if (stamp_ns == 0)
  {
    reason << "there is no exposure with all views so far";
  }
  else
  {
    reason << "there is no exposure at " << timeFromNanoseconds(stamp_ns) << " among the " << store_.size()
           << " that are kept";
  }
  return reason.str();
}

void ExposureIntake::wake()
{
  {
    // Who has just found that nothing breaks it off waits before this goes on.
    const std::lock_guard<std::mutex> lock(mutex_);
  }
  changed_.notify_all();
}

std::size_t ExposureIntake::size() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return store_.size();
}
}  // namespace xray_tracking
