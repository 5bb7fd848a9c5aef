#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <ros/time.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

namespace xray_tracking
{
/// What belongs to one exposure, by its stamp; null: not (yet) there.
struct StoredExposure
{
  std::vector<sensor_msgs::ImageConstPtr> images;             ///< one a detector
  std::vector<sensor_msgs::CameraInfoConstPtr> camera_infos;  ///< one a detector
  ros::SteadyTime last_arrival;
  bool answered = false;
};

/// The latest exposures, in the order of their stamps, and which of them is to be answered next. Each is handed out
/// once: complete ones as such, others when a later one is complete (every topic is in order) or has taken their place.
///
/// An image or camera_info more than a second older than the last one on its topic is the beginning of another run: all
/// is forgotten.
class ExposureStore
{
public:
  /// @param detectors names, for messages; @param capacity number of exposures kept, 1 or more
  /// @param in_turn whether next() will be called; without, exposures are kept for find() alone
  ExposureStore(std::vector<std::string> detectors, std::size_t capacity, bool in_turn);

  void addImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image);
  void addCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info);
  /// Whether time has jumped back since this was last asked.
  bool takeRestart() { return std::exchange(restarted_, false); }

  /// An exposure whose turn it is.
  struct Due
  {
    ros::Time stamp;
    StoredExposure exposure;
    std::string missing;  ///< names what is; empty if it is complete
  };
  std::optional<Due> next();

  /// The exposure of a stamp, or the latest with all images if the stamp is zero; null if there is none.
  const StoredExposure* find(const ros::Time& stamp) const;
  /// Names the first image or camera_info that the exposure lacks; empty if it has all.
  std::string missingView(const StoredExposure& exposure) const;

  std::size_t size() const { return exposures_.size(); }
  /// Number of exposures that wait for their turn.
  std::size_t waiting() const;

private:
  using Exposures = std::map<ros::Time, StoredExposure>;

  /// Forgets all if the stamp goes back. @param last on the same topic
  void noteArrival(const ros::Time& stamp, ros::Time& last);
  StoredExposure& at(const ros::Time& stamp);
  Due handOut(Exposures::iterator entry, const std::string& missing);

  std::vector<std::string> detectors_;
  std::size_t capacity_;
  bool in_turn_;
  Exposures exposures_;
  std::vector<Due> displaced_;                ///< never answered, and out of the store
  std::vector<ros::Time> last_images_;        ///< one a detector
  std::vector<ros::Time> last_camera_infos_;  ///< one a detector
  std::optional<ros::Time> last_answered_;
  bool restarted_ = false;
};
}  // namespace xray_tracking
