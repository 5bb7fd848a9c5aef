#include <memory>

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include "xray_tracking_hyperplane_tracker/hyperplane_tracker_ros.h"

namespace xray_tracking
{
class HyperplaneTrackerNodelet : public nodelet::Nodelet
{
  void onInit() override { tracker_ = std::make_unique<HyperplaneTrackerRos>(getNodeHandle(), getPrivateNodeHandle()); }

  std::unique_ptr<HyperplaneTrackerRos> tracker_;
};
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::HyperplaneTrackerNodelet, nodelet::Nodelet)
