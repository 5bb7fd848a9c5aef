#include "alignment_marker.h"

#include <string>

#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <interactive_markers/tools.h>
#include <rviz/default_plugin/interactive_markers/interactive_marker.h>
#include <rviz/display_context.h>
#include <visualization_msgs/InteractiveMarker.h>
#include <visualization_msgs/InteractiveMarkerFeedback.h>
#include <visualization_msgs/InteractiveMarkerPose.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
constexpr float kSize = 0.16F;  ///< somewhat more than a vertebra [m]

visualization_msgs::InteractiveMarker message()
{
  using visualization_msgs::InteractiveMarkerControl;
  visualization_msgs::InteractiveMarker marker;
  marker.header.frame_id = kRoomFrame;
  marker.name = "alignment";
  marker.scale = kSize;
  marker.pose.orientation.w = 1.0;
  for (int axis = 0; axis < 3; ++axis)
  {
    InteractiveMarkerControl control;
    control.orientation_mode = InteractiveMarkerControl::FIXED;
    // What turns x into the axis.
    const Eigen::Quaterniond turn =
        Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitX(), Eigen::Vector3d::Unit(axis));
    control.orientation.x = turn.x();
    control.orientation.y = turn.y();
    control.orientation.z = turn.z();
    control.orientation.w = turn.w();
    control.name = std::string("move_") + "xyz"[axis];
    control.interaction_mode = InteractiveMarkerControl::MOVE_AXIS;
    marker.controls.push_back(control);
    control.name = std::string("turn_") + "xyz"[axis];
    control.interaction_mode = InteractiveMarkerControl::ROTATE_AXIS;
    marker.controls.push_back(control);
  }
  interactive_markers::autoComplete(marker);  // arrows and rings
  return marker;
}
}  // namespace

AlignmentMarker::AlignmentMarker(rviz::DisplayContext* context, Dragged dragged)
  : context_(context),
    node_(context->getSceneManager()->getRootSceneNode()->createChildSceneNode()),
    marker_(std::make_unique<rviz::InteractiveMarker>(node_, context))
{
  marker_->processMessage(message());
  marker_->setShowDescription(false);
  marker_->setShowAxes(false);
  QObject::connect(marker_.get(), &rviz::InteractiveMarker::userFeedback, marker_.get(),
                   [this, dragged = std::move(dragged)](visualization_msgs::InteractiveMarkerFeedback& feedback)
                   {
                     // Without a control it is what place() has set, rounded.
                     if (feedback.event_type == visualization_msgs::InteractiveMarkerFeedback::POSE_UPDATE &&
                         !feedback.control_name.empty())
                     {
                       const Ogre::Vector3& p = marker_->getPosition();
                       const Ogre::Quaternion& q = marker_->getOrientation();
                       dragged({ p.x, p.y, p.z }, Eigen::Quaterniond(q.w, q.x, q.y, q.z));
                     }
                   });
}

AlignmentMarker::~AlignmentMarker()
{
  marker_.reset();
  context_->getSceneManager()->destroySceneNode(node_);
}

void AlignmentMarker::place(const Eigen::Vector3d& where, const Eigen::Quaterniond& turn)
{
  const Eigen::Vector3f p = where.cast<float>();
  const Eigen::Quaternionf q = turn.cast<float>();
  marker_->requestPoseUpdate({ p.x(), p.y(), p.z() }, { q.w(), q.x(), q.y(), q.z() });
}

void AlignmentMarker::update(float dt)
{
  marker_->update(dt);
}
}  // namespace xray_tracking
