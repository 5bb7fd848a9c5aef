#include "radiograph_display.h"

#include <pluginlib/class_list_macros.hpp>

PLUGINLIB_EXPORT_CLASS(xray_tracking::RadiographDisplay, rviz::Display)
