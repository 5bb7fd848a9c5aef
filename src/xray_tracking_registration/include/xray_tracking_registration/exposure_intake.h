#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <ros/ros.h>
#include <tf2_ros/buffer.h>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_registration/exposure_store.h"

namespace xray_tracking
{
/// An exposure that a request means.
struct FoundExposure
{
  std::int64_t stamp_ns = 0;
  std::size_t run = 0;  ///< number of runs that had ended before it
  StoredExposure views;
};

/// Takes in what the detectors send, once, where it comes in: images and camera_infos that are to be registered later,
/// if somebody asks for them. All methods are for any thread.
class ExposureIntake
{
public:
  /// Subscribes with the handle's callback queue, which may have several threads.
  /// @param name of the node, for the log; @param tf_buffer outlives this; @param capacity number of exposures kept
  ExposureIntake(const ros::NodeHandle& nh, const std::string& name, const TreatmentSetup& setup,
                 const tf2_ros::Buffer& tf_buffer, int capacity);

  /// The exposure of a stamp; waits for what of it is still on its way.
  /// @param stamp_ns zero: the latest with all views that are waited for
  /// @param without names of detectors that are not waited for
  /// @param broken_off asked whenever something has come, or wake() was called: no reason to wait any longer
  /// @param reason why there is none, if there is none
  std::optional<FoundExposure> find(std::int64_t stamp_ns, const std::vector<std::string>& without,
                                    const std::function<bool()>& broken_off, std::string& reason);
  /// find() asks whether it is broken off.
  void wake();

  std::size_t size() const;

private:
  /// Pixels are of the callbacks of its images, one at a time.
  struct Detector
  {
    ProjectionGeometry setup;  ///< what the setup says of it
    DetectorPixels pixels;
    std::size_t run = 0;  ///< that `pixels` is of
  };

  /// @param handle called with every message
  template <typename Message>
  void subscribeTo(const std::string& topic, std::function<void(const boost::shared_ptr<Message const>&)> handle);
  void takeImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image);
  void takeCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info);
  void warnOfDropped(const std::string& why) const;
  std::string whyNone(std::int64_t stamp_ns, const StoredExposure* stored,
                      const std::vector<std::string>& without) const;

  ros::NodeHandle nh_;
  const std::string name_;
  const IntensityModel intensity_;
  const tf2_ros::Buffer& tf_buffer_;
  const int capacity_;
  std::vector<Detector> detectors_;
  mutable std::mutex mutex_;  ///< of the store
  std::condition_variable changed_;
  ExposureStore store_;
  std::vector<ros::Subscriber> subscribers_;
};
}  // namespace xray_tracking
