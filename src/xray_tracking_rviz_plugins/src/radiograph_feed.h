#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include <xray_tracking_msgs/RegionResiduals.h>
#include <xray_tracking_msgs/TrackedRegion.h>

namespace xray_tracking
{
/// The last messages of one topic, oldest first. A stamp that is not newer than the last one begins anew: time was set
/// back, or a bag is played again.
template <typename Message>
class Recent
{
public:
  using ConstPtr = boost::shared_ptr<Message const>;

  explicit Recent(std::size_t capacity) : capacity_(capacity) {}

  void add(const ConstPtr& message)
  {
    if (!messages_.empty() && message->header.stamp <= messages_.back()->header.stamp)
    {
      messages_.clear();
    }
    messages_.push_back(message);
    if (messages_.size() > capacity_)
    {
      messages_.pop_front();
    }
  }

  bool empty() const { return messages_.empty(); }
  void clear() { messages_.clear(); }
  const std::deque<ConstPtr>& messages() const { return messages_; }
  /// The newest, or none.
  ConstPtr newest() const { return messages_.empty() ? nullptr : messages_.back(); }
  /// That of a stamp, or none.
  ConstPtr at(const ros::Time& stamp) const
  {
    for (auto message = messages_.rbegin(); message != messages_.rend(); ++message)
    {
      if ((*message)->header.stamp == stamp)
      {
        return *message;
      }
    }
    return nullptr;
  }

private:
  std::size_t capacity_;
  std::deque<ConstPtr> messages_;
};

/// For how long an image has not been the newest any more [s]: 0 while it is, infinite where time has begun anew since.
/// @param images stamps of the last ones, oldest first; @param stamp of one of them, or of an earlier one
/// @param age of the newest image, since it came [s]
double replacedFor(const std::vector<ros::Time>& images, const ros::Time& stamp, double age);

/// The stamp of the exposure to show: of those that all of the streams have, the newest; the newest image where a
/// stream is later than that by more than `patience` [s], or is silent. However slowly exposures come: what lies
/// between two of them is no lateness.
/// @param images stamps, oldest first, one or more; @param others those of what is shown along with them
/// @param age of the newest image, since it came [s]
ros::Time exposureToShow(const std::vector<ros::Time>& images, const std::vector<std::vector<ros::Time>>& others,
                         double age, double patience);

template <typename Message>
std::vector<ros::Time> stampsOf(const Recent<Message>& recent)
{
  std::vector<ros::Time> stamps;
  for (const auto& message : recent.messages())
  {
    stamps.push_back(message->header.stamp);
  }
  return stamps;
}

/// One detector's messages as they come, taken in a thread of its own.
class RadiographFeed
{
public:
  struct Messages
  {
    Recent<sensor_msgs::Image> images{ 12 };
    Recent<xray_tracking_msgs::TrackedRegion> regions{ 60 };
    Recent<xray_tracking_msgs::RegionResiduals> residuals{ 12 };  ///< none while they are not listened for
    sensor_msgs::CameraInfoConstPtr camera_info;                  ///< the newest
    double image_age = 0.0;  ///< since the newest image came, by the monotonic clock [s]
    double rate = 0.0;       ///< of images, over the last ones [Hz]
  };

  /// @param detector name, relative to nh's namespace, or resolved
  using ImageCame = std::function<void(const sensor_msgs::ImageConstPtr& image)>;
  /// @param image_came called in the thread with every image; may be empty
  RadiographFeed(const ros::NodeHandle& nh, const std::string& detector, ImageCame image_came);
  ~RadiographFeed();

  RadiographFeed(const RadiographFeed&) = delete;
  RadiographFeed& operator=(const RadiographFeed&) = delete;

  const std::string& detector() const { return detector_; }
  /// The tracker makes them only while somebody listens. Not at first.
  void listenForResiduals(bool listen);
  /// What there is, from any thread.
  Messages messages() const;
  void clear();

private:
  void takeImage(const sensor_msgs::ImageConstPtr& image);

  std::string detector_;
  ImageCame image_came_;
  mutable std::mutex mutex_;
  Messages messages_;
  std::deque<ros::SteadyTime> arrivals_;
  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  std::vector<ros::Subscriber> subscribers_;
  ros::Subscriber residuals_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
};
}  // namespace xray_tracking
