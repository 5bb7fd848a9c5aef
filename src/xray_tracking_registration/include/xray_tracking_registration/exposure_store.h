#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/time.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <xray_tracking_msgs/PatientMotion.h>

namespace xray_tracking
{
/// What belongs to one exposure, by its stamp; null: not (yet) there.
struct StoredExposure
{
  std::vector<sensor_msgs::ImageConstPtr> images;             ///< one a detector
  std::vector<sensor_msgs::CameraInfoConstPtr> camera_infos;  ///< one a detector
  xray_tracking_msgs::PatientMotionConstPtr motion;           ///< what tracking says
  geometry_msgs::PoseWithCovarianceStampedConstPtr pose;      ///< tracking's
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
  /// @param with_seed an exposure is complete only with what tracking says of it
  ExposureStore(std::vector<std::string> detectors, std::size_t capacity, bool with_seed);

  void addImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image);
  void addCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info);
  void addMotion(const xray_tracking_msgs::PatientMotionConstPtr& motion);
  void addPose(const geometry_msgs::PoseWithCovarianceStampedConstPtr& pose);

  /// An exposure whose turn it is.
  struct Due
  {
    ros::Time stamp;
    StoredExposure exposure;
    std::string missing;   ///< names what is; empty if it is complete
    bool restart = false;  ///< the first one after a jump back in time
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
  std::string missing(const StoredExposure& exposure) const;
  Due handOut(Exposures::iterator entry, const std::string& missing);

  std::vector<std::string> detectors_;
  std::size_t capacity_;
  bool with_seed_;
  Exposures exposures_;
  std::vector<Due> displaced_;                ///< never answered, and out of the store
  std::vector<ros::Time> last_images_;        ///< one a detector
  std::vector<ros::Time> last_camera_infos_;  ///< one a detector
  std::optional<ros::Time> last_answered_;
  bool restarted_ = false;
};
}  // namespace xray_tracking
