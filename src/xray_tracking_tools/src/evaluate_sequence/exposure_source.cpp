#include "exposure_source.h"

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <utility>

#include <geometry_msgs/PoseStamped.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
constexpr const char* kImages = "images";  // of InputFiles

/// One detector's exposure in a bag, read when it is asked for.
struct BagImage
{
  std::string topic;
  ros::Time time;  ///< of the message in the bag
  std::int64_t stamp_ns;
  std::size_t content;  ///< hash of its data
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
  const std::vector<std::string>& files() const { return recording_.files(); }

  std::map<std::int64_t, BagExposure> scan(const TreatmentSetup& setup)
  {
    std::map<std::int64_t, BagExposure> exposures;
    const auto view = recording_.messages();
    for (const rosbag::MessageInstance& instance : *view)
    {
      const std::string& topic = instance.getTopic();
      // `.../image_raw/compressed` is the detector's as `.../image_raw` is.
      const bool compressed = lastName(topic) == "compressed";
      const std::string raw_topic = compressed ? topic.substr(0, topic.rfind('/')) : topic;
      const auto is_of_setup = [&](const ProjectionGeometry& detector)
      { return detector.name() == detectorOf(raw_topic); };
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
      else if (detector != setup.detectors.end() && lastName(raw_topic) == "image_raw")
      {
        if (const std::optional<BagImage> image = imageOf(instance))
        {
          take(*image, compressed, exposures[image->stamp_ns].images.emplace(detector->name(), *image).first->second);
        }
      }
    }
    pair(setup, exposures);
    return exposures;
  }

  cv::Mat read(const BagImage& at, const ProjectionGeometry& detector)
  {
    const auto view = recording_.messages(at.topic, at.time);
    for (const rosbag::MessageInstance& instance : *view)
    {
      const auto image = instance.instantiate<sensor_msgs::Image>();
      const auto compressed = image ? nullptr : instance.instantiate<sensor_msgs::CompressedImage>();
      if ((!image && !compressed) ||
          nanosecondsFromTime(image ? image->header.stamp : compressed->header.stamp) != at.stamp_ns)
      {
        continue;
      }
      try
      {
        cv::Mat pixels = image ? pixelsFromMsg(*image).clone() : pixelsFromMsg(*compressed);
        if (const Eigen::Vector2i& size = detector.imageSize(); pixels.cols != size.x() || pixels.rows != size.y())
        {
          std::ostringstream message;
          message << "is " << pixels.cols << " x " << pixels.rows << " px, expected " << size.x() << " x " << size.y();
          throw std::runtime_error(message.str());
        }
        return pixels;
      }
      catch (const std::exception& error)
      {
        throw std::runtime_error(recording_.path() + ": " + where(at) + error.what());
      }
    }
    throw std::runtime_error(recording_.path() + ": " + at.topic + " has changed while it was read");
  }

private:
  static std::string where(const BagImage& at)
  {
    std::ostringstream text;
    text << at.topic << " at " << timeFromNanoseconds(at.stamp_ns) << " s: ";
    return text.str();
  }

  /// An image, compressed or not.
  static std::optional<BagImage> imageOf(const rosbag::MessageInstance& instance)
  {
    const auto of = [&instance](const auto& message)
    {
      const std::string_view data(reinterpret_cast<const char*>(message.data.data()), message.data.size());
      return BagImage{ instance.getTopic(), instance.getTime(), nanosecondsFromTime(message.header.stamp),
                       std::hash<std::string_view>()(data) };
    };
    if (const auto image = instance.instantiate<sensor_msgs::Image>())
    {
      return of(*image);
    }
    if (const auto image = instance.instantiate<sensor_msgs::CompressedImage>())
    {
      return of(*image);
    }
    return std::nullopt;
  }

  /// What there is of one detector and stamp: once more the same, of a loop, is nothing new, and a compressed image
  /// goes after what it was made of.
  static void take(const BagImage& image, bool compressed, BagImage& there)
  {
    if (image.topic != there.topic)
    {
      there = compressed ? there : image;
    }
    else if (image.content != there.content)
    {
      // Which of them is of the other views' moment nobody knows.
      throw std::runtime_error(where(image) + "a second image of this stamp, and another one, expected one");
    }
  }

  /// Makes one exposure of those that are nearly at one time and of different detectors: that of the first detector.
  static void pair(const TreatmentSetup& setup, std::map<std::int64_t, BagExposure>& exposures)
  {
    const auto tolerance = static_cast<std::int64_t>(kPairingTolerance * 1e9);
    for (auto at = exposures.begin(); at != exposures.end(); ++at)
    {
      for (auto next = std::next(at); next != exposures.end() && next->first - at->first <= tolerance;)
      {
        const auto& present = at->second.images;
        const bool apart = std::none_of(next->second.images.begin(), next->second.images.end(),
                                        [&](const auto& image) { return present.count(image.first) > 0; });
        if (!apart)
        {
          break;
        }
        at->second.images.insert(next->second.images.begin(), next->second.images.end());
        at->second.truth = at->second.truth ? at->second.truth : next->second.truth;
        next = exposures.erase(next);
      }
      const auto first = at->second.images.find(setup.detectors.front().name());
      if (first != at->second.images.end() && first->second.stamp_ns != at->first)
      {
        auto node = exposures.extract(at);
        node.key() = first->second.stamp_ns;
        at = exposures.insert(std::move(node)).position;
      }
    }
  }

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
  for (InputFiles& input : inputs)
  {
    if (input.what == kImages)
    {
      input.files.resize(stamps_ns.size() * setup.detectors.size());
    }
  }
}

ExposureSource sequenceSource(const std::string& folder)
{
  const auto sequence = std::make_shared<const Sequence>(loadSequence(folder));
  ExposureSource source;
  source.name = std::filesystem::canonical(folder).stem().string();
  source.path = folder;
  source.setup = sequence->setup;
  source.inputs = { { "tables", sequence->tables }, { kImages, {} } };
  for (const Exposure& exposure : sequence->exposures)
  {
    source.stamps_ns.push_back(exposure.stamp_ns);
    source.inputs.back().files.insert(source.inputs.back().files.end(), exposure.files.begin(), exposure.files.end());
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
      images.push_back(sequence->image(k, d));
    }
    return images;
  };
  return source;
}

ExposureSource bagSource(const std::string& bag_path, const std::string& setup_path)
{
  ExposureSource source;
  source.name = std::filesystem::path(bag_path).stem().string();
  source.path = bag_path;
  const auto reader = std::make_shared<BagReader>(bag_path);
  source.setup = reader->setup(setup_path);
  source.inputs = { { "tables", {} }, { "bag", reader->files() } };
  if (!setup_path.empty())
  {
    source.inputs.front().files.push_back(setup_path);
  }
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
    source.images = [reader, complete, detectors = source.setup.detectors](std::size_t k)
    {
      std::vector<cv::Mat> images;
      for (const ProjectionGeometry& detector : detectors)
      {
        images.push_back(reader->read(complete[k].images.at(detector.name()), detector));
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
