#include <memory>

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include "xray_tracking_motion_estimation/motion_estimation_ros.h"

namespace xray_tracking
{
class MotionEstimationNodelet : public nodelet::Nodelet
{
private:
  void onInit() override
  {
    motion_estimation_ = std::make_unique<MotionEstimationRos>(getNodeHandle(), getPrivateNodeHandle());
  }

  std::unique_ptr<MotionEstimationRos> motion_estimation_;
};
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::MotionEstimationNodelet, nodelet::Nodelet)
