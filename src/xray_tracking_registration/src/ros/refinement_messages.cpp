#include "xray_tracking_registration/refinement_messages.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <boost/make_shared.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::RefinementRequest;
using xray_tracking_msgs::RefinementResult;

/// Where a figure is not known, as NaN must not leave the node.
double finiteOrZero(double value)
{
  return std::isfinite(value) ? value : 0.0;
}

void readBound(const char* key, double value, double millimetres_per_unit, double& bound)
{
  requireOption(value >= 0.0 && std::isfinite(value), key, value, "0 (the node's own) or more");
  if (value > 0.0)
  {
    bound = value * millimetres_per_unit;
  }
}

RegistrationView viewOf(const ProjectionGeometry& detector, const StoredView& view, const tf2_ros::Buffer& tf_buffer)
{
  const UsableImage& image = *view.image;
  if (!image.fault.empty())
  {
    throw std::invalid_argument(image.fault);
  }
  const ProjectionGeometry geometry =
      view.geometry ? *view.geometry : geometryOf(detector, *view.camera_info, tf_buffer);
  const Eigen::Vector2i& size = geometry.imageSize();
  if (image.image.cols != size.x() || image.image.rows != size.y())
  {
    throw std::invalid_argument("the image is " + std::to_string(image.image.cols) + " x " +
                                std::to_string(image.image.rows) + ", expected camera_info's " +
                                std::to_string(size.x()) + " x " + std::to_string(size.y()));
  }
  RegistrationView result{ geometry, image.image };
  result.usable = image.usable;
  return result;
}
}  // namespace

UsableImage usableImageOf(const sensor_msgs::ImageConstPtr& image, const IntensityModel& intensity,
                          DetectorPixels& detector)
{
  UsableImage seen;
  try
  {
    seen = detector.look(pixelsFromMsg(*image), intensity, nanosecondsFromTime(image->header.stamp));
  }
  catch (const std::exception& error)
  {
    seen.fault = error.what();
  }
  return seen;
}

ProjectionGeometry geometryOf(const ProjectionGeometry& detector, const sensor_msgs::CameraInfo& info,
                              const tf2_ros::Buffer& tf_buffer)
{
  const RigidTransform room_from_optical =
      rigidFromTransformMsg(tf_buffer.lookupTransform(kRoomFrame, info.header.frame_id, ros::Time(0)).transform);
  return geometryFromCameraInfo(detector.name(), info, room_from_optical, detector.sourceToDetector());
}

std::vector<RegistrationView> viewsOf(const StoredExposure& exposure, const TreatmentSetup& setup,
                                      const std::vector<std::string>& without, const tf2_ros::Buffer& tf_buffer)
{
  for (const std::string& name : without)
  {
    setup.detector(name);  // throws where there is none
  }
  std::vector<RegistrationView> views;
  for (std::size_t i = 0; i < setup.detectors.size(); ++i)
  {
    if (std::find(without.begin(), without.end(), setup.detectors[i].name()) != without.end())
    {
      continue;
    }
    try
    {
      views.push_back(viewOf(setup.detectors[i], exposure[i], tf_buffer));
    }
    catch (const std::exception& error)  // tf2's too
    {
      throw std::invalid_argument(setup.detectors[i].name() + ": " + error.what());
    }
  }
  requireOption(views.size() >= 2, "the number of detectors to compare", views.size(),
                "two or more; the request leaves out " + std::to_string(without.size()));
  return views;
}

Search searchOf(const RefinementRequest& message)
{
  const bool wide = message.search == "wide";
  requireOption(wide || message.search.empty() || message.search == "near", "search", message.search,
                "near, wide or nothing, which is near");
  return wide ? Search::WIDE : Search::NEAR;
}

void applyRequest(const RefinementRequest& message, const TreatmentSetup& setup, RegistrationRequest& request)
{
  try
  {
    request.room_from_patient = rigidFromPoseMsg(message.seed);
  }
  catch (const std::invalid_argument& error)
  {
    throw std::invalid_argument(std::string("seed: ") + error.what());
  }
  readBound("max_translation", message.max_translation, kMillimetresPerMetre, request.max_translation_mm);
  readBound("max_rotation", message.max_rotation, 1.0, request.max_rotation_rad);
  requireOption(request.max_rotation_rad <= M_PI, "max_rotation", request.max_rotation_rad, "at most pi rad");
  double budget = request.time_budget.count();
  readBound("time_budget", message.time_budget, 1.0, budget);
  request.time_budget = std::chrono::duration<double>(budget);
  if (message.regions.empty())
  {
    return;
  }
  requireOption(message.regions.size() == setup.detectors.size(), "the number of regions", message.regions.size(),
                "none, or one for each of the " + std::to_string(setup.detectors.size()) + " detectors");
  for (std::size_t i = 0; i < setup.detectors.size(); ++i)
  {
    for (RegistrationView& view : request.views)
    {
      if (view.geometry.name() == setup.detectors[i].name())
      {
        view.region = rectFromRegionMsg(message.regions[i]);
      }
    }
  }
}

StoredExposure exposureOf(const RefinementRequest& message, const TreatmentSetup& setup)
{
  const std::string expected = "one for each of the " + std::to_string(setup.detectors.size()) + " detectors";
  requireOption(message.images.size() == setup.detectors.size(), "the number of images", message.images.size(),
                expected);
  requireOption(message.camera_infos.size() == setup.detectors.size(), "the number of camera_infos",
                message.camera_infos.size(), expected);
  StoredExposure exposure(message.images.size());
  for (std::size_t i = 0; i < message.images.size(); ++i)
  {
    // They have nothing to do with what the detectors send.
    DetectorPixels own;
    exposure[i].pixels = boost::make_shared<sensor_msgs::Image>(message.images[i]);
    exposure[i].image = usableImageOf(exposure[i].pixels, setup.intensity, own);
    exposure[i].camera_info = boost::make_shared<sensor_msgs::CameraInfo>(message.camera_infos[i]);
  }
  return exposure;
}

RefinementResult resultMessage(const RegistrationResult& result, const Eigen::Vector3d& target_centre)
{
  static_assert(static_cast<int>(RegistrationStatus::SUCCESS) == RefinementResult::SUCCESS &&
                    static_cast<int>(RegistrationStatus::UNRELIABLE) == RefinementResult::UNRELIABLE &&
                    static_cast<int>(RegistrationStatus::TIMED_OUT) == RefinementResult::TIMED_OUT &&
                    static_cast<int>(RegistrationStatus::CANCELLED) == RefinementResult::CANCELLED &&
                    static_cast<int>(RegistrationStatus::INVALID) == RefinementResult::INVALID,
                "the library's states begin the message's");
  RefinementResult message = resultMessage(static_cast<std::uint8_t>(result.status), result.reason);
  message.pose = poseWithCovarianceMsg(result.room_from_patient, result.poseCovariance(target_centre));
  message.probability = finiteOrZero(result.probability);
  message.similarity_before = finiteOrZero(result.similarity_before);
  message.similarity_after = finiteOrZero(result.similarity_after);
  message.iterations = static_cast<std::uint32_t>(result.iterations);
  for (const ViewResidual& view : result.views)
  {
    xray_tracking_msgs::ViewResidual residual;
    residual.similarity = finiteOrZero(view.similarity);
    residual.coarse_similarity = finiteOrZero(view.coarse_similarity);
    residual.noise = finiteOrZero(view.noise);
    residual.pull = finiteOrZero(view.pull_mm) / kMillimetresPerMetre;
    message.views.push_back(residual);
  }
  for (const Rival& rival : result.rivals)
  {
    xray_tracking_msgs::RivalPose rival_message;
    rival_message.pose = poseMsgFromRigid(rival.room_from_patient);
    rival_message.distance = rival.distance_mm / kMillimetresPerMetre;
    rival_message.rotation = rival.rotation_rad;
    rival_message.similarity = finiteOrZero(rival.similarity);
    message.rivals.push_back(rival_message);
  }
  message.time = ros::Duration(result.duration.count());
  return message;
}

RefinementResult resultMessage(std::uint8_t status, const std::string& reason)
{
  RefinementResult message;
  message.status = status;
  message.reason = reason;
  message.pose.pose.orientation.w = 1.0;
  return message;
}
}  // namespace xray_tracking
