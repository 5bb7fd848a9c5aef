// Readers of nodes' parameters.
#include <stdexcept>

#include <XmlRpcException.h>
#include <XmlRpcValue.h>

#include "reader_tools.h"
#include "xray_tracking_detector_simulator/simulator_parameters.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_motion_estimation/motion_estimation_parameters.h"
#include "xray_tracking_registration/registration_parameters.h"

namespace xray_tracking
{
namespace
{
/// A node's parameters, as the parameter server sends them.
ParameterReader parametersOf(const std::string& bytes)
{
  expected_name = "";  // any of them
  int at = 0;
  XmlRpc::XmlRpcValue values;
  try
  {
    values.fromXml(bytes, &at);
  }
  catch (const XmlRpc::XmlRpcException& error)
  {
    throw std::runtime_error(error.getMessage());  // roscpp's own to handle
  }
  return { "/node", values };
}

void readTracker(const std::string& bytes)
{
  TrackerParameters parameters = readTrackerParameters(parametersOf(bytes), "detector_a");
  parameters.adopt(setup());
  HyperplaneTracker{ parameters.tracker };
}

void readMotionEstimation(const std::string& bytes)
{
  const MotionEstimationParameters parameters = readMotionEstimationParameters(parametersOf(bytes));
  MotionMonitor{ parameters.monitor, setup().room_from_patient, setup().target_box };
}

void readRegistration(const std::string& bytes)
{
  readRegistrationParameters(parametersOf(bytes));
}

void readSimulator(const std::string& bytes)
{
  readParameters(parametersOf(bytes));
}
}  // namespace

std::vector<Reader> parameterReaders()
{
  return { { "tracker_parameters", readTracker },
           { "motion_parameters", readMotionEstimation },
           { "registration_parameters", readRegistration },
           { "simulator_parameters", readSimulator } };
}
}  // namespace xray_tracking
