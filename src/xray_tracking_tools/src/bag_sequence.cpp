#include "xray_tracking_tools/bag_sequence.h"

#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <opencv2/imgcodecs.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
constexpr auto kTolerance = static_cast<std::int64_t>(kPairingTolerance * 1e9);

std::string stampText(std::int64_t ns)
{
  char text[40];
  std::snprintf(text, sizeof(text), "%" PRId64 ".%09" PRId64, ns / 1000000000, ns % 1000000000);
  return text;
}

std::string poseText(const geometry_msgs::Pose& pose)
{
  char text[240];
  std::snprintf(text, sizeof(text), "%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", kMillimetresPerMetre * pose.position.x,
                kMillimetresPerMetre * pose.position.y, kMillimetresPerMetre * pose.position.z, pose.orientation.x,
                pose.orientation.y, pose.orientation.z, pose.orientation.w);
  return text;
}

void writeText(const std::filesystem::path& path, const std::string& text)
{
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file)
  {
    throw std::runtime_error(path.string() + ": cannot be written");
  }
}

class FolderWriter
{
public:
  FolderWriter(const Recording& recording, const TreatmentSetup& setup, std::filesystem::path folder,
               std::int64_t epoch_ns)
    : recording_(recording), setup_(setup), folder_(std::move(folder)), epoch_ns_(epoch_ns)
  {
  }

  ExtractedSequence run()
  {
    const auto view = recording_.messages(
        [](const rosbag::ConnectionInfo* connection)
        {
          const std::string name = lastName(rawTopic(connection->topic));
          return name == "image_raw" || name == "camera_info" || name == "patient_ground_truth";
        });
    for (const rosbag::MessageInstance& instance : *view)
    {
      const std::string detector = detectorOf(rawTopic(instance.getTopic()));
      if (const auto truth = instance.instantiate<geometry_msgs::PoseStamped>())
      {
        rigidFromPoseMsg(truth->pose);
        gold_standard_[sequenceStamp(truth->header.stamp)] = poseText(truth->pose);
      }
      else if (!hasDetector(detector))
      {
        continue;
      }
      else if (const auto info = instance.instantiate<sensor_msgs::CameraInfo>())
      {
        const std::string difference = cameraInfoDifference(*info, setup_.detector(detector));
        if (!difference.empty())
        {
          throw std::runtime_error(instance.getTopic() + " differs from the setup's detector: " + difference);
        }
      }
      else if (const auto image = instance.instantiate<sensor_msgs::Image>())
      {
        writeImage(detector, instance.getTopic(), image->header.stamp, pixelsFromMsg(*image));
      }
      else if (const auto compressed = instance.instantiate<sensor_msgs::CompressedImage>())
      {
        writeImage(detector, instance.getTopic(), compressed->header.stamp, pixelsFromMsg(*compressed));
      }
    }
    return writeTables();
  }

private:
  bool hasDetector(const std::string& name) const
  {
    return std::any_of(setup_.detectors.begin(), setup_.detectors.end(),
                       [&](const ProjectionGeometry& detector) { return detector.name() == name; });
  }

  std::int64_t sequenceStamp(const ros::Time& stamp) const
  {
    const std::int64_t ns = nanosecondsFromTime(stamp) - epoch_ns_;
    if (ns < 0)
    {
      throw std::runtime_error("stamp " + stampText(nanosecondsFromTime(stamp)) +
                               " s is before the sequence's 0, which is at " + stampText(epoch_ns_) + " s");
    }
    return ns;
  }

  void writeImage(const std::string& detector, const std::string& topic, const ros::Time& stamp, const cv::Mat& image)
  {
    const std::int64_t stamp_ns = sequenceStamp(stamp);
    const std::string where = topic + " at " + stampText(stamp_ns) + " s: ";
    const Eigen::Vector2i& size = setup_.detector(detector).imageSize();
    if (image.cols != size.x() || image.rows != size.y())
    {
      throw std::runtime_error(where + "is " + std::to_string(image.cols) + " x " + std::to_string(image.rows) +
                               ", expected " + std::to_string(size.x()) + " x " + std::to_string(size.y()));
    }
    std::map<std::string, std::string>& files = frames_[stamp_ns];
    const std::string name = detector + "_" + stampText(stamp_ns) + ".png";
    if (!files.emplace(detector, name).second)
    {
      throw std::runtime_error(where + "a second image of this stamp: is it a loop? Expected one");
    }
    if (!cv::imwrite((folder_ / name).string(), image))
    {
      throw std::runtime_error((folder_ / name).string() + ": cannot be written");
    }
  }

  ExtractedSequence writeTables()
  {
    ExtractedSequence result;
    std::string frames = "stamp_s,detector,file\n";
    std::string gold = "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
    result.gold_standard = !gold_standard_.empty();
    for (auto at = frames_.begin(); at != frames_.end();)
    {
      // As loadSequence() pairs them: of detectors apart, within a few milliseconds.
      std::map<std::string, std::pair<std::int64_t, std::string>> views;
      std::optional<std::string> pose;
      const std::int64_t first = at->first;
      const auto fits = [&](const std::map<std::string, std::string>& files) {
        return std::none_of(files.begin(), files.end(), [&](const auto& file) { return views.count(file.first) != 0; });
      };
      for (; at != frames_.end() && at->first - first <= kTolerance && fits(at->second); ++at)
      {
        for (const auto& [detector, file] : at->second)
        {
          views[detector] = { at->first, file };
        }
        const auto truth = gold_standard_.find(at->first);
        if (truth != gold_standard_.end() && !pose)
        {
          pose = stampText(at->first) + "," + truth->second + "\n";
        }
      }
      if (views.size() < setup_.detectors.size())
      {
        ++result.incomplete;
        for (const auto& [detector, view] : views)
        {
          std::filesystem::remove(folder_ / view.second);
        }
        continue;
      }
      ++result.exposures;
      std::multimap<std::int64_t, std::string> rows;
      for (const auto& [detector, view] : views)
      {
        rows.emplace(view.first, stampText(view.first) + "," + detector + "," + view.second + "\n");
      }
      for (const auto& [stamp_ns, row] : rows)
      {
        frames += row;
      }
      result.gold_standard = result.gold_standard && pose.has_value();
      gold += pose.value_or("");
    }
    if (result.exposures == 0)
    {
      throw std::runtime_error("no exposure with an image of every detector of the setup");
    }
    writeText(folder_ / "frames.csv", frames);
    const bool described = recording_.description() && !recording_.description()->gold_standard.empty();
    if (result.gold_standard)
    {
      writeText(folder_ / "gold_standard.csv", described ? recording_.description()->gold_standard : gold);
    }
    return result;
  }

  const Recording& recording_;
  const TreatmentSetup& setup_;
  std::filesystem::path folder_;
  std::int64_t epoch_ns_;
  std::map<std::int64_t, std::map<std::string, std::string>> frames_;  ///< files by detector
  std::map<std::int64_t, std::string> gold_standard_;
};
}  // namespace

ExtractedSequence writeSequenceFolder(const Recording& recording, const std::string& setup_path,
                                      const std::string& folder)
{
  const TreatmentSetup setup = recording.setup(setup_path);
  // Without a slash at its end: what is written first goes beside it, not into it.
  const std::filesystem::path path(folder.substr(0, folder.find_last_not_of('/') + 1));
  if (path.empty() || std::filesystem::exists(path))
  {
    throw std::runtime_error(folder + ": is there already, expected a new folder");
  }
  const std::filesystem::path partial(path.string() + ".partial");
  std::filesystem::remove_all(partial);
  std::filesystem::create_directories(partial);
  try
  {
    const ExtractedSequence result =
        FolderWriter(recording, setup, partial, recording.description() ? recording.description()->epoch_ns : 0).run();
    std::string text = setup_path.empty() ? recording.description()->setup : selfContainedSetup(setup_path);
    text += "frames: frames.csv\n";
    text += result.gold_standard ? "gold_standard: gold_standard.csv\n" : "";
    writeText(partial / "sequence.yaml", text);
    std::filesystem::rename(partial, path);
    return result;
  }
  catch (const std::exception& error)
  {
    std::filesystem::remove_all(partial);
    throw std::runtime_error(recording.path() + ": " + error.what());
  }
}
}  // namespace xray_tracking
