#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "xray_tracking_core/sequence/stamp_policy.h"
#include "xray_tracking_registration/usable_pixels.h"

namespace xray_tracking
{
/// One detector's part of an exposure, as far as it is there.
struct StoredView
{
  sensor_msgs::CameraInfoConstPtr camera_info;
  /// What camera_info and tf said when it came; nothing if they did not yet say, or not in a way that is of use.
  std::optional<ProjectionGeometry> geometry;
  std::optional<UsableImage> image;
  sensor_msgs::ImageConstPtr pixels;  ///< whose pixels `image` has, unless these are its own
};
using StoredExposure = std::vector<StoredView>;  ///< one a detector

/// The latest exposures, by their stamps, for who asks about them.
///
/// Stamps of every topic are taken as StampPolicy says; where time goes back on one of them, another run has begun and
/// all is forgotten.
class ExposureStore
{
public:
  /// @param detectors names, for messages; @param capacity number of exposures kept, 1 or more
  ExposureStore(std::vector<std::string> detectors, std::size_t capacity);

  /// Of what has just come. @param now_ns as StampPolicy::take. @return why it is to be dropped; empty: it is to be
  /// kept
  std::string takeImage(std::size_t detector, std::int64_t stamp_ns, std::int64_t now_ns);
  std::string takeCameraInfo(std::size_t detector, std::int64_t stamp_ns, std::int64_t now_ns);
  /// Keeps what was taken. @param run in which that was; nothing is kept of one that has ended since
  void keepImage(std::size_t detector, std::int64_t stamp_ns, std::size_t run, UsableImage image,
                 const sensor_msgs::ImageConstPtr& pixels);
  void keepCameraInfo(std::size_t detector, std::int64_t stamp_ns, const sensor_msgs::CameraInfoConstPtr& camera_info,
                      std::optional<ProjectionGeometry> geometry);
  /// Number of runs that have ended.
  std::size_t run() const { return run_; }

  /// The exposure of a stamp; null if there is none.
  /// @param stamp_ns zero: that of the latest that lacks nothing, which it is then set to
  /// @param without as missingView's
  const StoredExposure* find(std::int64_t& stamp_ns, const std::vector<std::string>& without = {}) const;
  /// Names the first image or camera_info that the exposure lacks; empty if it has all.
  /// @param without names of detectors that may be missing
  std::string missingView(const StoredExposure& exposure, const std::vector<std::string>& without = {}) const;

  std::size_t size() const { return exposures_.size(); }

private:
  struct Topic
  {
    StampPolicy stamps;
    bool of_this_run = true;  ///< something of the run has come
  };
  struct Topics
  {
    Topic images;
    Topic camera_infos;
  };

  /// @param name of the topic. @return as takeImage
  std::string take(Topic& topic, const std::string& name, std::int64_t stamp_ns, std::int64_t now_ns);
  StoredExposure& at(std::int64_t stamp_ns);

  std::vector<std::string> detectors_;
  std::size_t capacity_;
  std::map<std::int64_t, StoredExposure> exposures_;
  std::vector<Topics> topics_;  ///< one a detector
  std::size_t run_ = 0;
  std::int64_t newest_ns_ = 0;  ///< stamp of the run
};
}  // namespace xray_tracking
