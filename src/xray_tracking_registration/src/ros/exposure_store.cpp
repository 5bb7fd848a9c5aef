#include "xray_tracking_registration/exposure_store.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace xray_tracking
{
ExposureStore::ExposureStore(std::vector<std::string> detectors, std::size_t capacity)
  : detectors_(std::move(detectors)), capacity_(capacity), topics_(detectors_.size())
{
}

std::string ExposureStore::takeImage(std::size_t detector, std::int64_t stamp_ns, std::int64_t now_ns)
{
  return take(topics_[detector].images, detectors_[detector] + "/image_raw", stamp_ns, now_ns);
}

std::string ExposureStore::takeCameraInfo(std::size_t detector, std::int64_t stamp_ns, std::int64_t now_ns)
{
  return take(topics_[detector].camera_infos, detectors_[detector] + "/camera_info", stamp_ns, now_ns);
}

std::string ExposureStore::take(Topic& topic, const std::string& name, std::int64_t stamp_ns, std::int64_t now_ns)
{
  using Verdict = StampPolicy::Verdict;
  const Verdict verdict = topic.stamps.take(stamp_ns, now_ns);
  if (verdict == Verdict::FUTURE || verdict == Verdict::REPEATED_OR_LATE)
  {
    return name + ": " + topic.stamps.why();
  }
  if (verdict == Verdict::RESTART && topic.of_this_run)
  {
    ++run_;
    exposures_.clear();
    newest_ns_ = stamp_ns;
    // What is on its way on the other topics may be of the run before.
    for (Topics& topics : topics_)
    {
      for (Topic* other : { &topics.images, &topics.camera_infos })
      {
        if (other != &topic)
        {
          other->stamps.reset();
          other->of_this_run = false;
        }
      }
    }
  }
  // A message of the run before that comes late is as far ahead as time has gone back.
  topic.of_this_run = topic.of_this_run || stamp_ns <= newest_ns_ + StampPolicy::kJump;
  if (!topic.of_this_run)
  {
    return name + ": is of the run before, which ended when time went back to " + std::to_string(newest_ns_) + " ns";
  }
  newest_ns_ = std::max(newest_ns_, stamp_ns);
  return std::string();
}

void ExposureStore::keepImage(std::size_t detector, std::int64_t stamp_ns, std::size_t run, UsableImage image,
                              const sensor_msgs::ImageConstPtr& pixels)
{
  if (run == run_)
  {
    StoredView& view = at(stamp_ns)[detector];
    view.pixels = pixels;
    view.image = std::move(image);
  }
}

void ExposureStore::keepCameraInfo(std::size_t detector, std::int64_t stamp_ns,
                                   const sensor_msgs::CameraInfoConstPtr& camera_info,
                                   std::optional<ProjectionGeometry> geometry)
{
  StoredView& view = at(stamp_ns)[detector];
  view.camera_info = camera_info;
  view.geometry = std::move(geometry);
}

StoredExposure& ExposureStore::at(std::int64_t stamp_ns)
{
  const auto [entry, is_new] = exposures_.try_emplace(stamp_ns, detectors_.size());
  if (is_new && exposures_.size() > capacity_)
  {
    exposures_.erase(entry == exposures_.begin() ? std::next(entry) : exposures_.begin());
  }
  return entry->second;
}

std::string ExposureStore::missingView(const StoredExposure& exposure, const std::vector<std::string>& without) const
{
  for (std::size_t i = 0; i < detectors_.size(); ++i)
  {
    if (std::find(without.begin(), without.end(), detectors_[i]) != without.end())
    {
      continue;
    }
    if (!exposure[i].image)
    {
      return detectors_[i] + "/image_raw has not arrived";
    }
    if (!exposure[i].camera_info)
    {
      return detectors_[i] + "/camera_info has not arrived";
    }
  }
  return std::string();
}

const StoredExposure* ExposureStore::find(std::int64_t& stamp_ns, const std::vector<std::string>& without) const
{
  if (stamp_ns != 0)
  {
    const auto entry = exposures_.find(stamp_ns);
    return entry == exposures_.end() ? nullptr : &entry->second;
  }
  const auto latest = std::find_if(exposures_.rbegin(), exposures_.rend(),
                                   [&](const auto& entry) { return missingView(entry.second, without).empty(); });
  if (latest == exposures_.rend())
  {
    return nullptr;
  }
  stamp_ns = latest->first;
  return &latest->second;
}
}  // namespace xray_tracking
