#include <ros/ros.h>

#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "hyperplane_tracker");
  xray_tracking::HyperplaneTrackerRos tracker{ ros::NodeHandle(), ros::NodeHandle("~") };
  ros::spin();
  return 0;
}
