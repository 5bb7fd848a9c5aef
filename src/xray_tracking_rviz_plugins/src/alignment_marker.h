#pragma once

#include <functional>
#include <memory>

#include <Eigen/Geometry>

namespace Ogre
{
class SceneNode;
}

namespace rviz
{
class DisplayContext;
class InteractiveMarker;
}  // namespace rviz

namespace xray_tracking
{
/// Arrows and rings in the scene by which the mouse moves and turns something along the room's axes, with RViz's tool
/// Interact. All from the GUI thread.
class AlignmentMarker
{
public:
  /// @param where in the room [m]; @param turn since the start
  using Dragged = std::function<void(const Eigen::Vector3d& where, const Eigen::Quaterniond& turn)>;

  AlignmentMarker(rviz::DisplayContext* context, Dragged dragged);
  ~AlignmentMarker();

  AlignmentMarker(const AlignmentMarker&) = delete;
  AlignmentMarker& operator=(const AlignmentMarker&) = delete;

  /// Not while it is being dragged, but then. As Dragged's.
  void place(const Eigen::Vector3d& where, const Eigen::Quaterniond& turn);
  /// To be called for every frame. @param dt since the last time [s]
  void update(float dt);

private:
  rviz::DisplayContext* context_;
  Ogre::SceneNode* node_;
  std::unique_ptr<rviz::InteractiveMarker> marker_;
};
}  // namespace xray_tracking
