#include <memory>

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include "xray_tracking_registration/registration_ros.h"

namespace xray_tracking
{
class RegistrationNodelet : public nodelet::Nodelet
{
private:
  void onInit() override { registration_ = std::make_unique<RegistrationRos>(getNodeHandle(), getPrivateNodeHandle()); }

  std::unique_ptr<RegistrationRos> registration_;
};
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::RegistrationNodelet, nodelet::Nodelet)
