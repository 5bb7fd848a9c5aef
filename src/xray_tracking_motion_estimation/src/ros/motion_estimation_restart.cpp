#include <chrono>
#include <exception>
#include <utility>

#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

// How MotionEstimationRos goes on where a process before it has died.
namespace xray_tracking
{
namespace
{
/// A disk that takes longer is not waited for: meanwhile nothing else happens here, and the gate falls silent.
constexpr std::chrono::milliseconds kSlowDisk(200);
}  // namespace

void MotionEstimationRos::readRestartFile()
{
  restart_file_.emplace(pnh_, "motion 3");
  if (!restart_file_->succeeds())
  {
    return;
  }
  BeamHold& hold = monitor_->beamHold();
  try
  {
    before_ = runMemoryFrom(restart_file_->read());
    hold.takeUp(before_->hold, before_->operator_present, static_cast<std::int64_t>(ros::SteadyTime::now().toNSec()));
    ROS_WARN_STREAM(pnh_.getNamespace() << " has died and was started again"
                                        << (hold.held() ? "; the beam is still held: " + hold.why() : ""));
  }
  catch (const std::exception& error)
  {
    hold.hold("the node has died, and whether an operator held the beam is not known");
    ROS_ERROR_STREAM(
        pnh_.getNamespace() << " has died and was started again; it holds the beam until it is released, as "
                               "who held it is not known: "
                            << error.what());
    cannotGoOn(error.what());
    return;
  }
  if (!before_->motion)
  {
    cannotGoOn("no pose was known");
  }
}

void MotionEstimationRos::cannotGoOn(const std::string& why)
{
  before_.reset();
  monitor_->restart("the node has died, and what its poses counted from is lost: " + why);
  ROS_ERROR_STREAM(
      pnh_.getNamespace() << " cannot go on where it was: " << why
                          << "; no pose before a registration is accepted, or somebody calls ~restart with "
                             "the patient at the initial pose");
}

void MotionEstimationRos::takeUp(std::int64_t stamp)
{
  const std::optional<RunMemory> before = std::exchange(before_, std::nullopt);
  if (!before)
  {
    return;
  }
  const std::string changed = difference(before->detectors, monitor_->tracks().geometries());
  if (!changed.empty())
  {
    cannotGoOn(changed);
  }
  else if (stamp > before->motion->last_stamp)
  {
    try
    {
      monitor_->takeUp(*before->motion);
      ROS_WARN_STREAM(pnh_.getNamespace() << " goes on from the pose at " << before->motion->last_stamp << " ns");
    }
    catch (const std::exception& error)
    {
      cannotGoOn(error.what());
    }
  }
  // A bag that is played again begins where it began.
  else if (!ros::Time::isSimTime())
  {
    cannotGoOn("time went back");
  }
}

bool MotionEstimationRos::keep(bool wait)
{
  if (!restart_file_)
  {
    return true;
  }
  const std::chrono::milliseconds patience = wait ? kSlowDisk : std::chrono::milliseconds(0);
  if (keeping_.valid() && keeping_.wait_for(patience) != std::future_status::ready)
  {
    return false;
  }
  // Until it can be taken up, what was left behind is what is known.
  RunMemory memory = before_.value_or(RunMemory());
  if (has_geometry_)
  {
    for (const ProjectionGeometry& geometry : monitor_->tracks().geometries())
    {
      memory.detectors.push_back(geometry.description());
    }
    memory.motion = monitor_->memory();
  }
  memory.hold = kept_hold_ = monitor_->beamHold().why();
  memory.operator_present = kept_operator_ = monitor_->beamHold().operatorHeard();
  try
  {
    keeping_ = std::async(std::launch::async,
                          [file = *restart_file_, text = textOf(memory)]
                          {
                            try
                            {
                              file.write(text);
                              return true;
                            }
                            catch (const std::exception& error)
                            {
                              ROS_WARN_STREAM_THROTTLE(60.0, "what to go on from after a restart is not kept: "
                                                                 << error.what() << "; make room, or mend the folder");
                              return false;
                            }
                          });
  }
  catch (const std::exception& error)  // no thread is to be had
  {
    ROS_WARN_STREAM_THROTTLE(60.0, "what to go on from after a restart is not kept: " << error.what());
    return false;
  }
  return !wait || (keeping_.wait_for(patience) == std::future_status::ready && keeping_.get());
}
}  // namespace xray_tracking
