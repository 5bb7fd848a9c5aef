#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <rviz/display.h>
#include <sensor_msgs/CameraInfo.h>
#include <opencv2/core.hpp>

#include "grey_scale.h"
#include "radiograph_feed.h"
#include "radiograph_plane.h"
#include "room_watch.h"
#include "worker.h"

namespace rviz
{
class BoolProperty;
class FloatProperty;
class StringProperty;
}  // namespace rviz

namespace xray_tracking
{
/// The image of every detector as a plane where the detector stands, with its source, central ray and field of view.
/// Images come in and are converted in threads of their own; the GUI thread only hands them to the graphics card.
class RadiographDisplay : public rviz::Display
{
  Q_OBJECT
public:
  RadiographDisplay();
  ~RadiographDisplay() override;

  void update(float wall_dt, float ros_dt) override;
  void reset() override;
  void setTopic(const QString& topic, const QString& datatype) override;

protected:
  void onInitialize() override;
  void onEnable() override;
  void onDisable() override;

private Q_SLOTS:
  void updateWindow();
  void updateLook();
  void updateDetectors();

private:
  struct Settings
  {
    bool automatic = true;
    GreyWindow window;
    bool inverted = false;
  };

  /// One detector; `convert` is its worker's job.
  class Detector
  {
  public:
    Detector(const ros::NodeHandle& nh, const std::string& name, Ogre::SceneManager* scene, Ogre::SceneNode* parent);

    void set(const Settings& settings);

    std::unique_ptr<RadiographPlane> plane;
    sensor_msgs::CameraInfoConstPtr shown_info;  ///< of the plane's geometry
    double shown_distance = 0.0;                 ///< [mm]
    /// The newest picture, if it has not been taken; fault out. @return whether there is one
    bool take(cv::Mat& grey, std::string& fault);
    const RadiographFeed& feed() const { return *feed_; }
    void clear();

  private:
    void convert();

    std::mutex mutex_;
    Settings settings_;
    sensor_msgs::ImageConstPtr image_;  ///< the newest
    cv::Mat grey_;
    bool fresh_ = false;
    std::string fault_;
    WindowFollower follower_;  ///< from here the worker's alone
    GreyScale scale_;
    std::unique_ptr<Worker> worker_;
    std::unique_ptr<RadiographFeed> feed_;  ///< last: it wakes the worker
  };

  Settings settings() const;
  /// Takes note of what detectors there are, now and then.
  void followRoom(float wall_dt);
  /// Puts the plane where the detector stands. @return what is missing; empty if it stands
  std::string place(Detector& detector);
  void show(const Detector& detector, const std::string& fault);

  rviz::StringProperty* detectors_property_;
  rviz::BoolProperty* automatic_property_;
  rviz::FloatProperty* black_property_;
  rviz::FloatProperty* white_property_;
  rviz::BoolProperty* inverted_property_;
  rviz::FloatProperty* opacity_property_;
  rviz::BoolProperty* rays_property_;
  rviz::FloatProperty* distance_property_;

  std::unique_ptr<RoomWatch> watch_;
  Room room_;
  float since_room_ = 0.0F;
  std::vector<std::unique_ptr<Detector>> detectors_;
  cv::Mat grey_;
};
}  // namespace xray_tracking
