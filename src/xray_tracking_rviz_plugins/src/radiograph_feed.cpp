#include "radiograph_feed.h"

#include <algorithm>
#include <limits>

namespace xray_tracking
{
double replacedFor(const std::vector<ros::Time>& images, const ros::Time& stamp, double age)
{
  if (images.empty() || stamp > images.back())
  {
    return std::numeric_limits<double>::infinity();
  }
  if (stamp == images.back())
  {
    return 0.0;
  }
  // Of one that is not kept any more, the next one is not known: it counts from its own stamp.
  const ros::Time since = stamp < images.front() ? stamp : *std::upper_bound(images.begin(), images.end(), stamp);
  return (images.back() - since).toSec() + age;
}

ros::Time exposureToShow(const std::vector<ros::Time>& images, const std::vector<std::vector<ros::Time>>& others,
                         double age, double patience)
{
  for (auto image = images.rbegin(); image != images.rend(); ++image)
  {
    if (replacedFor(images, *image, age) > patience)
    {
      break;
    }
    const bool complete = std::all_of(others.begin(), others.end(),
                                      [&](const auto& stamps)
                                      { return std::find(stamps.begin(), stamps.end(), *image) != stamps.end(); });
    if (complete)
    {
      return *image;
    }
  }
  return images.back();
}

RadiographFeed::RadiographFeed(const ros::NodeHandle& nh, const std::string& detector, ImageCame image_came)
  : detector_(detector), image_came_(std::move(image_came)), nh_(nh)
{
  nh_.setCallbackQueue(&queue_);
  const ros::TransportHints hints = ros::TransportHints().tcpNoDelay();
  const boost::function<void(const sensor_msgs::ImageConstPtr&)> image = [this](const auto& message)
  { takeImage(message); };
  const boost::function<void(const sensor_msgs::CameraInfoConstPtr&)> info = [this](const auto& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    messages_.camera_info = message;
  };
  const boost::function<void(const xray_tracking_msgs::TrackedRegionConstPtr&)> region = [this](const auto& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    messages_.regions.add(message);
  };
  subscribers_ = { nh_.subscribe<sensor_msgs::Image>(detector + "/image_raw", 2, image, nullptr, hints),
                   nh_.subscribe<sensor_msgs::CameraInfo>(detector + "/camera_info", 2, info, nullptr, hints),
                   nh_.subscribe<xray_tracking_msgs::TrackedRegion>(detector + "/tracked_region", 10, region, nullptr,
                                                                    hints) };
  spinner_ = std::make_unique<ros::AsyncSpinner>(1, &queue_);
  spinner_->start();
}

RadiographFeed::~RadiographFeed()
{
  spinner_->stop();
}

void RadiographFeed::listenForResiduals(bool listen)
{
  if (!listen)
  {
    residuals_.shutdown();
    const std::lock_guard<std::mutex> lock(mutex_);
    messages_.residuals.clear();
    return;
  }
  const boost::function<void(const xray_tracking_msgs::RegionResidualsConstPtr&)> residuals =
      [this](const auto& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    messages_.residuals.add(message);
  };
  residuals_ = nh_.subscribe<xray_tracking_msgs::RegionResiduals>(detector_ + "/region_residuals", 2, residuals,
                                                                  nullptr, ros::TransportHints().tcpNoDelay());
}

void RadiographFeed::takeImage(const sensor_msgs::ImageConstPtr& image)
{
  constexpr std::size_t kArrivals = 10;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    messages_.images.add(image);
    arrivals_.push_back(ros::SteadyTime::now());
    if (arrivals_.size() > kArrivals)
    {
      arrivals_.pop_front();
    }
  }
  if (image_came_)
  {
    image_came_(image);
  }
}

RadiographFeed::Messages RadiographFeed::messages() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  Messages messages = messages_;
  if (!arrivals_.empty())
  {
    messages.image_age = (ros::SteadyTime::now() - arrivals_.back()).toSec();
    const double span = (arrivals_.back() - arrivals_.front()).toSec();
    messages.rate = span > 0.0 ? static_cast<double>(arrivals_.size() - 1) / span : 0.0;
  }
  return messages;
}

void RadiographFeed::clear()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  messages_ = Messages();
  arrivals_.clear();
}
}  // namespace xray_tracking
