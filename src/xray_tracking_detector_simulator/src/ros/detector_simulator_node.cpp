#include <ros/ros.h>

#include "xray_tracking_detector_simulator/detector_simulator_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "detector_simulator");
  xray_tracking::DetectorSimulatorRos simulator{ ros::NodeHandle(), ros::NodeHandle("~") };
  ros::spin();
  return 0;
}
