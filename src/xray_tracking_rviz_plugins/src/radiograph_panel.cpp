#include "radiograph_panel.h"

#include <pluginlib/class_list_macros.hpp>

PLUGINLIB_EXPORT_CLASS(xray_tracking::RadiographPanel, rviz::Panel)
