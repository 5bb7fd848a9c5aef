#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "xray_tracking_core/sequence/stamp_policy.h"

namespace xray_tracking
{
/// What belongs to one exposure, by its stamp; null: not (yet) there.
struct StoredExposure
{
  std::vector<sensor_msgs::ImageConstPtr> images;             ///< one a detector
  std::vector<sensor_msgs::CameraInfoConstPtr> camera_infos;  ///< one a detector
};

/// The latest exposures, by their stamps, for who asks about them.
///
/// Stamps of every topic are taken as StampPolicy says; where time goes back on one of them, another run has begun and
/// all is forgotten.
class ExposureStore
{
public:
  /// @param detectors names, for messages; @param capacity number of exposures kept, 1 or more
  ExposureStore(std::vector<std::string> detectors, std::size_t capacity);

  /// @param now_ns as StampPolicy::take. @return why it was dropped; empty: it is kept
  std::string addImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image, std::int64_t now_ns);
  std::string addCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info,
                            std::int64_t now_ns);
  /// Whether another run has begun since this was last asked.
  bool takeRestart() { return std::exchange(restarted_, false); }

  /// The exposure of a stamp [ns], or the latest with all views if the stamp is zero; null if there is none.
  const StoredExposure* find(std::int64_t stamp_ns) const;
  /// Names the first image or camera_info that the exposure lacks; empty if it has all.
  std::string missingView(const StoredExposure& exposure) const;

  std::size_t size() const { return exposures_.size(); }

private:
  struct Topics
  {
    StampPolicy images;
    StampPolicy camera_infos;
  };

  /// @return whether the message is to be kept
  bool take(StampPolicy& topic, std::int64_t stamp_ns, std::int64_t now_ns);
  StoredExposure& at(std::int64_t stamp_ns);

  std::vector<std::string> detectors_;
  std::size_t capacity_;
  std::map<std::int64_t, StoredExposure> exposures_;
  std::vector<Topics> topics_;  ///< one a detector
  bool restarted_ = false;
};
}  // namespace xray_tracking
