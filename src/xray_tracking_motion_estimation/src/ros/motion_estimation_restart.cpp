#include <chrono>
#include <exception>
#include <utility>

#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

// How MotionEstimationRos goes on where a process before it was killed.
namespace xray_tracking
{
void MotionEstimationRos::readRestartFile()
{
  try
  {
    restart_file_.emplace(pnh_, "motion 1");
  }
  catch (const std::exception& error)
  {
    ROS_WARN_STREAM(pnh_.getNamespace() << " keeps nothing for the case that it is killed: " << error.what());
    return;
  }
  BeamHold& hold = monitor_->beamHold();
  try
  {
    const std::optional<std::string> text = restart_file_->read();
    if (!text)
    {
      return;
    }
    before_ = runMemoryFrom(*text);
    hold.takeUp(before_->hold, before_->operator_present, static_cast<std::int64_t>(ros::SteadyTime::now().toNSec()));
    ROS_WARN_STREAM(pnh_.getNamespace() << " was killed and started again"
                                        << (hold.held() ? "; the beam is still held: " + hold.why() : ""));
  }
  catch (const std::exception& error)
  {
    hold.hold("what was kept of the process before is damaged: whether an operator held the beam is not known");
    ROS_ERROR_STREAM(pnh_.getNamespace() << " was killed, cannot go on where it was, and holds the beam until it is "
                                            "released: "
                                         << error.what());
  }
}

void MotionEstimationRos::takeUp(std::int64_t stamp)
{
  const std::optional<RunMemory> before = std::exchange(before_, std::nullopt);
  if (!before || !before->motion)
  {
    return;
  }
  std::string fault = difference(before->detectors, geometry_->geometries());
  if (fault.empty() && stamp <= before->motion->last_stamp)
  {
    fault = "the exposure is older than the last one of then: time went back";
  }
  try
  {
    if (fault.empty())
    {
      monitor_->takeUp(*before->motion);
      ROS_WARN_STREAM(pnh_.getNamespace() << " goes on from the pose of " << before->motion->last_stamp
                                          << " ns, which is unverified until it is confirmed again");
      return;
    }
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  ROS_ERROR_STREAM(pnh_.getNamespace() << " does not go on where it was before it was killed, but from the setup's "
                                          "initial pose: "
                                       << fault);
}

void MotionEstimationRos::keep(bool wait)
{
  if (!restart_file_)
  {
    return;
  }
  if (keeping_.valid())
  {
    if (!wait && keeping_.wait_for(std::chrono::seconds(0)) == std::future_status::timeout)
    {
      return;  // a disk that is slow
    }
    keeping_.get();
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
  memory.hold = monitor_->beamHold().why();
  memory.operator_present = monitor_->beamHold().operatorHeard();
  keeping_ = std::async(std::launch::async,
                        [file = *restart_file_, text = textOf(memory)]
                        {
                          try
                          {
                            file.write(text);
                          }
                          catch (const std::exception& error)
                          {
                            ROS_WARN_STREAM_THROTTLE(
                                60.0, "nothing is kept for the case that this node is killed: " << error.what());
                          }
                        });
  if (wait)
  {
    keeping_.wait();
  }
}
}  // namespace xray_tracking
