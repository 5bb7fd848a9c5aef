#include <ros/ros.h>

#include "xray_tracking_tools/treatment_room_publisher_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "treatment_room_publisher");
  xray_tracking::TreatmentRoomPublisherRos publisher(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
  return 0;
}
