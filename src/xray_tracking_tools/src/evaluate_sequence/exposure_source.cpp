#include "exposure_source.h"

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <utility>

#include <cv_bridge/cv_bridge.h>
#include <geometry_msgs/PoseStamped.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
/// One detector's exposure in a bag, read when it is asked for.
struct BagImage
{
  std::string topic;
  ros::Time time;  ///< of the message in the bag
};

/// What a bag has of an exposure.
struct BagExposure
{
  std::map<std::string, BagImage> images;  ///< by detector
  std::optional<RigidTransform> truth;
};

void checkCameraInfo(const sensor_msgs::CameraInfo& info, const ProjectionGeometry& detector)
{
  const std::string difference = cameraInfoDifference(info, detector);
  if (!difference.empty())
  {
    throw std::runtime_error(detector.name() + "/camera_info differs from the setup's detector: " + difference);
  }
}

class BagReader
{
public:
  explicit BagReader(const std::string& path) : recording_(path) {}

  TreatmentSetup setup(const std::string& path) const { return recording_.setup(path); }

  std::map<std::int64_t, BagExposure> scan(const TreatmentSetup& setup)
  {
    std::map<std::int64_t, BagExposure> exposures;
    const auto view = recording_.messages();
    for (const rosbag::MessageInstance& instance : *view)
    {
      const std::string& topic = instance.getTopic();
      const auto is_of_setup = [&](const ProjectionGeometry& detector) { return detector.name() == detectorOf(topic); };
      const auto detector = std::find_if(setup.detectors.begin(), setup.detectors.end(), is_of_setup);
      if (lastName(topic) == "patient_ground_truth")
      {
        if (const auto truth = instance.instantiate<geometry_msgs::PoseStamped>())
        {
          exposures[nanosecondsFromTime(truth->header.stamp)].truth = rigidFromPoseMsg(truth->pose);
        }
      }
      else if (detector != setup.detectors.end() && lastName(topic) == "camera_info")
      {
        if (const auto info = instance.instantiate<sensor_msgs::CameraInfo>())
        {
          checkCameraInfo(*info, *detector);
        }
      }
      else if (detector != setup.detectors.end() && lastName(topic) == "image_raw")
      {
        if (const auto image = instance.instantiate<sensor_msgs::Image>())
        {
          exposures[nanosecondsFromTime(image->header.stamp)].images[detector->name()] = { topic, instance.getTime() };
        }
      }
    }
    return exposures;
  }

  cv::Mat read(const BagImage& at, std::int64_t stamp_ns)
  {
    const auto view = recording_.messages(at.topic, at.time);
    for (const rosbag::MessageInstance& instance : *view)
    {
      const auto image = instance.instantiate<sensor_msgs::Image>();
      if (image && nanosecondsFromTime(image->header.stamp) == stamp_ns)
      {
        return cv_bridge::toCvCopy(image)->image;
      }
    }
    throw std::runtime_error(recording_.path() + ": " + at.topic + " has changed while it was read");
  }

private:
  Recording recording_;
};
}  // namespace

void ExposureSource::keepFirst(int frames)
{
  if (frames < 1 || static_cast<std::size_t>(frames) > stamps_ns.size())
  {
    throw std::invalid_argument("--frames is " + std::to_string(frames) + ", but there are " +
                                std::to_string(stamps_ns.size()) + " exposures");
  }
  stamps_ns.resize(static_cast<std::size_t>(frames));
  gold_standard.resize(std::min(stamps_ns.size(), gold_standard.size()));
}

ExposureSource sequenceSource(const std::string& folder)
{
  const auto sequence = std::make_shared<const Sequence>(loadSequence(folder));
  ExposureSource source;
  source.name = std::filesystem::canonical(folder).stem().string();
  source.setup = sequence->setup;
  for (const Exposure& exposure : sequence->exposures)
  {
    source.stamps_ns.push_back(exposure.stamp_ns);
  }
  for (const StampedPose& pose : sequence->gold_standard)
  {
    source.gold_standard.push_back(pose.room_from_patient);
  }
  source.images = [sequence](std::size_t k)
  {
    std::vector<cv::Mat> images;
    for (std::size_t d = 0; d < sequence->setup.detectors.size(); ++d)
    {
      images.push_back(readXrayImage(sequence->exposures[k].files[d], sequence->setup.detectors[d].imageSize()));
    }
    return images;
  };
  return source;
}

ExposureSource bagSource(const std::string& bag_path, const std::string& setup_path)
{
  ExposureSource source;
  source.name = std::filesystem::path(bag_path).stem().string();
  const auto reader = std::make_shared<BagReader>(bag_path);
  source.setup = reader->setup(setup_path);
  try
  {
    std::vector<BagExposure> complete;
    bool all_have_truth = true;
    for (auto& [stamp_ns, exposure] : reader->scan(source.setup))
    {
      if (exposure.images.size() == source.setup.detectors.size())
      {
        source.stamps_ns.push_back(stamp_ns);
        all_have_truth = all_have_truth && exposure.truth;
        complete.push_back(std::move(exposure));
      }
    }
    if (complete.empty())
    {
      throw std::runtime_error("no exposure with an image_raw of every detector of the setup");
    }
    for (const BagExposure& exposure : complete)
    {
      if (all_have_truth)
      {
        source.gold_standard.push_back(*exposure.truth);
      }
    }
    source.images = [reader, complete, detectors = source.setup.detectors, stamps = source.stamps_ns](std::size_t k)
    {
      std::vector<cv::Mat> images;
      for (const ProjectionGeometry& detector : detectors)
      {
        images.push_back(reader->read(complete[k].images.at(detector.name()), stamps[k]));
      }
      return images;
    };
  }
  catch (const std::exception& error)
  {
    throw std::runtime_error(bag_path + ": " + error.what());
  }
  return source;
}
}  // namespace xray_tracking
