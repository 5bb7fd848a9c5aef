#include <ros/ros.h>

#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "motion_estimation");
  xray_tracking::MotionEstimationRos motion_estimation(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
  return 0;
}
