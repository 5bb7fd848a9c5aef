#include <memory>

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include "xray_tracking_detector_simulator/detector_simulator_ros.h"

namespace xray_tracking
{
class DetectorSimulatorNodelet : public nodelet::Nodelet
{
  void onInit() override
  {
    simulator_ = std::make_unique<DetectorSimulatorRos>(getNodeHandle(), getPrivateNodeHandle());
  }

  std::unique_ptr<DetectorSimulatorRos> simulator_;
};
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::DetectorSimulatorNodelet, nodelet::Nodelet)
