#include "xray_tracking_motion_estimation/motion_monitor.h"

// How one MotionMonitor goes on where another was killed.
namespace xray_tracking
{
std::optional<MotionMemory> MotionMonitor::memory() const
{
  std::optional<MotionMemory> memory = tracks_.memory();
  if (!memory || !last_pose_)
  {
    return std::nullopt;
  }
  memory->last_stamp = last_pose_->first;
  memory->last_pose = last_pose_->second;
  if (options_.refinement.mode == RefinementMode::NEVER)
  {
    memory->doubt = gate_.verification().fault();
  }
  return memory;
}

void MotionMonitor::takeUp(const MotionMemory& memory)
{
  tracks_.takeUp(memory);
  last_pose_ = { memory.last_stamp, memory.last_pose };
  last_was_registered_ = false;
  last_seen_ = memory.last_stamp;
  if (options_.refinement.mode == RefinementMode::NEVER)
  {
    if (!memory.doubt.empty())
    {
      gate_.doubt(memory.doubt);
    }
    return;
  }
  // Whatever the one before had been told, of contradictions and refusals too: what it knew is a claim here.
  const std::string doubt =
      "the node was killed and started again, and no registration has confirmed the pose that it "
      "goes on from";
  gate_.doubt(doubt);
  gate_.refused(doubt, false);
  if (options_.method != PoseMethod::TRACKING)
  {
    rules_.restart(doubt);
  }
}
}  // namespace xray_tracking
