#include <ros/ros.h>

#include "xray_tracking_registration/registration_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "registration");
  xray_tracking::RegistrationRos registration(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
  return 0;
}
