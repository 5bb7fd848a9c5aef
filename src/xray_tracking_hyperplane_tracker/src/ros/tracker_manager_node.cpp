// A nodelet manager that has the trackers of some detectors in it from its start: started again, it has them again at
// once. Loaders of their own (nodelet load) take ten seconds to see that their manager has died, and wait for ever if
// it dies before their bond to it has formed.
#include <algorithm>
#include <string>
#include <vector>

#include <nodelet/loader.h>
#include <ros/ros.h>

#include "xray_tracking_core/geometry/projection_geometry.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "tracker_manager");
  std::vector<std::string> arguments;
  ros::removeROSArgs(argc, argv, arguments);
  if (arguments.size() < 2)
  {
    ROS_FATAL(
        "usage: tracker_manager_node DETECTOR...: expected the detectors whose images are tracked, e.g. detector_a");
    return 1;
  }
  // Of others ROS throws, or looks for the images in another namespace.
  const auto wrong = std::find_if_not(arguments.begin() + 1, arguments.end(), xray_tracking::isDetectorName);
  if (wrong != arguments.end())
  {
    ROS_FATAL(
        "detector '%s': expected a name as in the setup file, a letter followed by letters, digits and underscores",
        wrong->c_str());
    return 1;
  }

  nodelet::Loader manager;
  for (auto detector = arguments.begin() + 1; detector != arguments.end(); ++detector)
  {
    const std::string tracker = ros::names::resolve(*detector + "_hyperplane_tracker");
    nodelet::M_string names;
    for (const char* name : { "image_raw", "tracked_region", "tracked_region_image", "region_residuals", "train_region",
                              "retrain", "reset" })
      names[ros::names::resolve(name)] = ros::names::resolve(*detector + "/" + name);
    if (!manager.load(tracker, "xray_tracking_hyperplane_tracker/HyperplaneTracker", names, {}))
    {
      ROS_FATAL(
          "%s cannot be loaded: expected the plugin of an installed xray_tracking_hyperplane_tracker, and each "
          "detector named once",
          tracker.c_str());
      return 1;
    }
  }
  ros::spin();
  return 0;
}
