#include "xray_tracking_motion_estimation/motion_monitor.h"

// How one MotionMonitor goes on where another has died.
namespace xray_tracking
{
std::optional<MotionMemory> MotionMonitor::memory() const
{
  std::optional<MotionMemory> memory = tracks_.memory();
  if (!memory || !last_pose_)
  {
    return std::nullopt;
  }
  for (std::size_t i = 0; i < memory->sights.size(); ++i)
  {
    memory->sights[i].usual = i < clarity_.usual().size() ? clarity_.usual()[i] : std::nullopt;
    memory->sights[i].stated = proposer_.statedFor(i);
  }
  memory->last_stamp = last_pose_->first;
  memory->last_pose = last_pose_->second;
  memory->doubt = gate_.verification().fault();
  return memory;
}

void MotionMonitor::takeUp(const MotionMemory& memory)
{
  tracks_.takeUp(memory);
  clarity_.takeUp(memory.sights, memory.last_stamp);
  proposer_.takeUp(memory.sights);
  last_pose_ = { memory.last_stamp, memory.last_pose };
  last_was_registered_ = false;
  last_seen_ = memory.last_stamp;
  std::string doubt = memory.doubt;
  if (options_.refinement.mode != RefinementMode::NEVER)
  {
    // Whatever the one before had been told, of contradictions and refusals too: what it knew is a claim here.
    doubt = "the node has died, and no registration has confirmed the pose that it goes on from";
    if (options_.method != PoseMethod::TRACKING)
    {
      rules_.restart(doubt);
    }
  }
  gate_.takeUp(memory.last_stamp, rules_.displacement(memory.last_pose), doubt);
}
}  // namespace xray_tracking
