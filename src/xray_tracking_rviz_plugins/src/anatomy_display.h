#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/ros.h>
#include <rviz/display.h>
#include <std_msgs/String.h>
#include <Eigen/Core>

#include "room_watch.h"

namespace Ogre
{
class SceneNode;
}

namespace rviz
{
class BillboardLine;
class BoolProperty;
class ColorProperty;
class FloatProperty;
class MovableText;
class Shape;
}  // namespace rviz

namespace xray_tracking
{
struct Anatomy;
class AnatomyLoader;
class SliceObject;
class SurfaceObject;

/// The patient's CT at the patient's pose: bones, target, planes through the target; where the target really is, if
/// that is known; how well its place is known. Made of the setup file's CT, or the phantom, in a thread of its own.
class AnatomyDisplay : public rviz::Display
{
  Q_OBJECT
public:
  AnatomyDisplay();
  ~AnatomyDisplay() override;

  void update(float wall_dt, float ros_dt) override;
  void reset() override;

protected:
  void onInitialize() override;
  void onEnable() override;
  void onDisable() override;

private Q_SLOTS:
  void updateLook();

private:
  void followRoom();
  void take(const Anatomy& anatomy);
  void placePatient();
  /// Where the patient is not as it was measured just now, it is seen through.
  void fade(bool faded);
  void placeGhost();
  void placeEllipsoid();
  /// Room to the fixed frame. @return false, with a status, if that is not known
  bool placeRoom();
  void poseCb(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message);
  void volumeCb(const std_msgs::String::ConstPtr& message);
  void alignmentCb(const geometry_msgs::PoseStamped::ConstPtr& message);
  void truthCb(const geometry_msgs::PoseStamped::ConstPtr& message);

  rviz::BoolProperty *bones_, *target_, *box_, *truth_, *ellipsoid_;
  rviz::ColorProperty *bone_colour_, *target_colour_;
  rviz::FloatProperty *bone_opacity_, *target_opacity_, *truth_opacity_, *slice_opacity_, *level_, *window_;
  std::array<rviz::BoolProperty*, 3> slices_;

  Ogre::SceneNode* room_node_ = nullptr;
  Ogre::SceneNode* patient_node_ = nullptr;
  std::unique_ptr<SurfaceObject> bone_surface_, target_surface_, ghost_;
  std::array<std::unique_ptr<SliceObject>, 3> slice_objects_;
  std::unique_ptr<rviz::BillboardLine> box_lines_;
  std::unique_ptr<rviz::Shape> ellipsoid_shape_;
  std::unique_ptr<rviz::MovableText> ellipsoid_text_;
  Ogre::SceneNode* text_node_ = nullptr;

  std::unique_ptr<RoomWatch> watch_;
  std::unique_ptr<AnatomyLoader> loader_;
  std::shared_ptr<const TreatmentSetup> setup_;
  std::optional<std::string> volume_;  ///< path of the CT that the registration has loaded; empty: the phantom
  std::string shown_;                  ///< what the anatomy is of
  bool wanted_ = false;                ///< anatomy has to be made of the setup
  bool faded_ = true;
  float since_room_ = 1.0F;

  ros::Subscriber pose_subscriber_, truth_subscriber_, alignment_subscriber_, volume_subscriber_;
  geometry_msgs::PoseWithCovarianceStamped::ConstPtr pose_;
  geometry_msgs::PoseStamped::ConstPtr truth_message_;
  geometry_msgs::PoseStamped::ConstPtr alignment_;
  ros::SteadyTime pose_arrival_, truth_arrival_, alignment_arrival_;
};
}  // namespace xray_tracking
