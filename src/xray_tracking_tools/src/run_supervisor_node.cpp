#include <cstdio>
#include <cstdlib>
#include <exception>

#include <ros/ros.h>

#include "xray_tracking_tools/run_supervisor_ros.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "run_supervisor");
  try
  {
    xray_tracking::RunSupervisorRos supervisor(ros::NodeHandle(), ros::NodeHandle("~"));
    const int status = supervisor.run();
    // Not by return: a call to a process that hangs may still be open in the starting thread.
    std::fflush(stdout);
    std::_Exit(status);
  }
  catch (const std::exception& e)
  {
    // Not by ROS_FATAL: the node handles that are gone by now have shut ROS down.
    std::fprintf(stderr, "run_supervisor: %s\n", e.what());
    return 1;
  }
}
