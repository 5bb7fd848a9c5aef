#include "xray_tracking_registration/exposure_store.h"

#include <algorithm>
#include <iterator>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
ExposureStore::ExposureStore(std::vector<std::string> detectors, std::size_t capacity)
  : detectors_(std::move(detectors)), capacity_(capacity), topics_(detectors_.size())
{
}

bool ExposureStore::take(StampPolicy& topic, std::int64_t stamp_ns, std::int64_t now_ns)
{
  using Verdict = StampPolicy::Verdict;
  const Verdict verdict = topic.take(stamp_ns, now_ns);
  if (verdict == Verdict::RESTART)
  {
    exposures_.clear();
    // What is on its way on the other topics may be of the run before: it is forgotten when they start again, too.
    for (Topics& topics : topics_)
    {
      for (StampPolicy* other : { &topics.images, &topics.camera_infos })
      {
        if (other != &topic)
        {
          other->reset();
        }
      }
    }
    restarted_ = true;
  }
  return verdict == Verdict::ACCEPT || verdict == Verdict::RESTART;
}

StoredExposure& ExposureStore::at(std::int64_t stamp_ns)
{
  const auto [entry, is_new] = exposures_.try_emplace(stamp_ns);
  StoredExposure& exposure = entry->second;
  if (is_new)
  {
    exposure.images.resize(detectors_.size());
    exposure.camera_infos.resize(detectors_.size());
    if (exposures_.size() > capacity_)
    {
      exposures_.erase(entry == exposures_.begin() ? std::next(entry) : exposures_.begin());
    }
  }
  return exposure;
}

std::string ExposureStore::addImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image, std::int64_t now_ns)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(image->header.stamp);
  StampPolicy& topic = topics_[detector].images;
  // roscpp links publisher and subscriber of one process twice if both come up at the same time.
  if (const auto kept = exposures_.find(stamp_ns); kept != exposures_.end() && kept->second.images[detector] == image)
  {
    return std::string();
  }
  if (!take(topic, stamp_ns, now_ns))
  {
    return detectors_[detector] + "/image_raw: " + topic.why();
  }
  at(stamp_ns).images[detector] = image;
  return std::string();
}

std::string ExposureStore::addCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info,
                                         std::int64_t now_ns)
{
  const std::int64_t stamp_ns = nanosecondsFromTime(camera_info->header.stamp);
  StampPolicy& topic = topics_[detector].camera_infos;
  if (const auto kept = exposures_.find(stamp_ns);
      kept != exposures_.end() && kept->second.camera_infos[detector] == camera_info)
  {
    return std::string();
  }
  if (!take(topic, stamp_ns, now_ns))
  {
    return detectors_[detector] + "/camera_info: " + topic.why();
  }
  at(stamp_ns).camera_infos[detector] = camera_info;
  return std::string();
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
  return std::string();
}

const StoredExposure* ExposureStore::find(std::int64_t stamp_ns) const
{
  if (stamp_ns != 0)
  {
    const auto entry = exposures_.find(stamp_ns);
    return entry == exposures_.end() ? nullptr : &entry->second;
  }
  const auto latest = std::find_if(exposures_.rbegin(), exposures_.rend(),
                                   [this](const auto& entry) { return missingView(entry.second).empty(); });
  return latest == exposures_.rend() ? nullptr : &latest->second;
}
}  // namespace xray_tracking
