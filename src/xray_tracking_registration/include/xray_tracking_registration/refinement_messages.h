#pragma once

#include <string>

#include <tf2_ros/buffer.h>

#include <xray_tracking_msgs/RefinementRequest.h>
#include <xray_tracking_msgs/RefinementResult.h>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_registration/exposure_store.h"
#include "xray_tracking_registration/registration.h"

/// Messages of a refinement to the library's types and back.
namespace xray_tracking
{
/// An image as it comes. Its pixels are the message's, or its own. Never throws: what is wrong is the image's fault.
UsableImage usableImageOf(const sensor_msgs::ImageConstPtr& image, const IntensityModel& intensity,
                          DetectorPixels& detector);

/// A detector's projection: by its camera_info and its frame's place in the room, as tf has it now; the panel's
/// distance, which neither has, from the setup. @throws std::exception saying what is wrong, or what tf does not know
ProjectionGeometry geometryOf(const ProjectionGeometry& detector, const sensor_msgs::CameraInfo& info,
                              const tf2_ros::Buffer& tf_buffer);

/// The views of an exposure that is complete. Where a geometry could not be told when its camera_info came, it is tried
/// again. They refer to the exposure's images.
/// @param without names of detectors that are left out
/// @throws std::invalid_argument saying what is wrong with which view
std::vector<RegistrationView> viewsOf(const StoredExposure& exposure, const TreatmentSetup& setup,
                                      const std::vector<std::string>& without, const tf2_ros::Buffer& tf_buffer);

/// How wide a request wants the pose searched. @throws std::invalid_argument naming the field and its value
Search searchOf(const xray_tracking_msgs::RefinementRequest& message);

/// Seed, bounds, budget and regions of a request onto `request`, whose values stay where the message has zeros.
/// @param setup that the request's regions are of, one a detector
/// @throws std::invalid_argument naming the field and its value
void applyRequest(const xray_tracking_msgs::RefinementRequest& message, const TreatmentSetup& setup,
                  RegistrationRequest& request);

/// The exposure that a request brings along. @throws std::invalid_argument naming what is missing
StoredExposure exposureOf(const xray_tracking_msgs::RefinementRequest& message, const TreatmentSetup& setup);

/// @param target_centre of the target box, patient frame [mm]: what the result's covariance is about
xray_tracking_msgs::RefinementResult resultMessage(const RegistrationResult& result,
                                                   const Eigen::Vector3d& target_centre);

/// One without a registration.
xray_tracking_msgs::RefinementResult resultMessage(std::uint8_t status, const std::string& reason);
}  // namespace xray_tracking
