#include "xray_tracking_registration/exposure_store.h"

#include <algorithm>
#include <iterator>

namespace xray_tracking
{
namespace
{
/// Time that stamps go back by when a bag starts again; less is a disorder of exposures.
const ros::Duration kBackwardJump(1.0);
}  // namespace

ExposureStore::ExposureStore(std::vector<std::string> detectors, std::size_t capacity, bool in_turn)
  : detectors_(std::move(detectors)),
    capacity_(capacity),
    in_turn_(in_turn),
    last_images_(detectors_.size()),
    last_camera_infos_(detectors_.size())
{
}

StoredExposure& ExposureStore::at(const ros::Time& stamp)
{
  const auto [entry, is_new] = exposures_.try_emplace(stamp);
  StoredExposure& exposure = entry->second;
  exposure.last_arrival = ros::SteadyTime::now();
  if (!is_new)
  {
    return exposure;
  }
  exposure.images.resize(detectors_.size());
  exposure.camera_infos.resize(detectors_.size());
  // Too late for an answer, but somebody may ask for it.
  exposure.answered = !in_turn_ || (last_answered_ && stamp <= *last_answered_);
  if (exposures_.size() > capacity_)
  {
    const auto oldest = entry == exposures_.begin() ? std::next(entry) : exposures_.begin();
    if (!oldest->second.answered)
    {
      displaced_.push_back(
          handOut(oldest, "it gave way, as more than " + std::to_string(capacity_) + " exposures were kept"));
    }
    exposures_.erase(oldest);
  }
  return exposure;
}

void ExposureStore::noteArrival(const ros::Time& stamp, ros::Time& last)
{
  if (stamp < last && last - stamp > kBackwardJump)
  {
    exposures_.clear();
    displaced_.clear();
    last_answered_.reset();
    last_images_.assign(detectors_.size(), ros::Time());
    last_camera_infos_.assign(detectors_.size(), ros::Time());
    restarted_ = true;
  }
  last = stamp;
}

void ExposureStore::addImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image)
{
  noteArrival(image->header.stamp, last_images_[detector]);
  at(image->header.stamp).images[detector] = image;
}

void ExposureStore::addCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info)
{
  noteArrival(camera_info->header.stamp, last_camera_infos_[detector]);
  at(camera_info->header.stamp).camera_infos[detector] = camera_info;
}

std::string ExposureStore::missingView(const StoredExposure& exposure) const
{
  for (std::size_t i = 0; i < detectors_.size(); ++i)
  {
    if (!exposure.images[i])
    {
      return detectors_[i] + "/image_raw has not arrived";
    }
    if (!exposure.camera_infos[i])
    {
      return detectors_[i] + "/camera_info has not arrived";
    }
  }
  return "";
}

ExposureStore::Due ExposureStore::handOut(Exposures::iterator entry, const std::string& missing)
{
  entry->second.answered = true;
  last_answered_ = last_answered_ ? std::max(*last_answered_, entry->first) : entry->first;
  return { entry->first, entry->second, missing };
}

std::optional<ExposureStore::Due> ExposureStore::next()
{
  if (!displaced_.empty())
  {
    Due due = std::move(displaced_.front());
    displaced_.erase(displaced_.begin());
    return due;
  }
  auto oldest = exposures_.end();
  for (auto entry = exposures_.begin(); entry != exposures_.end(); ++entry)
  {
    if (entry->second.answered)
    {
      continue;
    }
    oldest = oldest == exposures_.end() ? entry : oldest;
    if (missingView(entry->second).empty())
    {
      return handOut(oldest, missingView(oldest->second));
    }
  }
  return std::nullopt;
}

const StoredExposure* ExposureStore::find(const ros::Time& stamp) const
{
  if (!stamp.isZero())
  {
    const auto entry = exposures_.find(stamp);
    return entry == exposures_.end() ? nullptr : &entry->second;
  }
  const auto latest = std::find_if(exposures_.rbegin(), exposures_.rend(),
                                   [this](const auto& entry) { return missingView(entry.second).empty(); });
  return latest == exposures_.rend() ? nullptr : &latest->second;
}

std::size_t ExposureStore::waiting() const
{
  return displaced_.size() + static_cast<std::size_t>(std::count_if(exposures_.begin(), exposures_.end(),
                                                                    [](const auto& e) { return !e.second.answered; }));
}
}  // namespace xray_tracking
