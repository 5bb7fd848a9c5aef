#include "xray_tracking_tools/recording.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <utility>

#include <ros/common.h>
#include <std_msgs/String.h>
#include <boost/crc.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/core/version.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr double kProjectionTolerance = 1e-3;  // [px], of what a camera_info's numbers differ by

std::string printed(const char* format, double a, double b)
{
  char text[120];
  std::snprintf(text, sizeof(text), format, a, b);
  return text;
}

/// x_0.bag, x_1.bag, ... of the first one; else the file alone.
std::vector<std::string> partsOf(const std::string& path)
{
  const std::string first = "_0.bag";
  std::vector<std::string> parts{ path };
  if (path.size() <= first.size() || path.compare(path.size() - first.size(), first.size(), first) != 0)
  {
    return parts;
  }
  const std::string stem = path.substr(0, path.size() - first.size());
  for (int k = 1; std::filesystem::exists(stem + "_" + std::to_string(k) + ".bag"); ++k)
  {
    parts.push_back(stem + "_" + std::to_string(k) + ".bag");
  }
  return parts;
}
}  // namespace

RunDescription describeRun(const std::string& setup_path)
{
  RunDescription description;
  description.setup = selfContainedSetup(setup_path);
  description.versions["xray_tracking"] = XRAY_TRACKING_VERSION;
  description.versions["roscpp"] = std::to_string(ROS_VERSION_MAJOR) + "." + std::to_string(ROS_VERSION_MINOR) + "." +
                                   std::to_string(ROS_VERSION_PATCH);
  description.versions["opencv"] = CV_VERSION;
  description.versions["eigen"] = std::to_string(EIGEN_WORLD_VERSION) + "." + std::to_string(EIGEN_MAJOR_VERSION) +
                                  "." + std::to_string(EIGEN_MINOR_VERSION);
  const std::string ct = ctFingerprint(treatmentSetupFromText(description.setup, setup_path).ct_path);
  if (!ct.empty())
  {
    description.versions["ct"] = ct;
  }
  return description;
}

std::string textOf(const RunDescription& description)
{
  nlohmann::json json{ { "setup", description.setup },
                       { "epoch_ns", description.epoch_ns },
                       { "versions", description.versions } };
  if (!description.gold_standard.empty())
  {
    json["gold_standard"] = description.gold_standard;
  }
  if (!description.parameters.empty())
  {
    json["parameters"] = nlohmann::json::parse(description.parameters);
  }
  // Names come from files, whose bytes need not be UTF-8.
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

RunDescription runDescriptionFromText(const std::string& text)
{
  try
  {
    const nlohmann::json json = nlohmann::json::parse(text);
    RunDescription description;
    description.setup = json.at("setup").get<std::string>();
    const nlohmann::json epoch = json.value("epoch_ns", nlohmann::json(0));
    // Within what a stamp can be: differences of two do not overflow.
    requireOption(epoch.is_number_integer() && epoch.get<double>() >= 0.0 && epoch.get<double>() < 0x1p32 * 1e9,
                  std::string(kRunDescriptionTopic) + ": epoch_ns", epoch, "a whole number, 0 to 2^32 s");
    description.epoch_ns = epoch.get<std::int64_t>();
    description.gold_standard = json.value("gold_standard", std::string());
    description.versions = json.value("versions", std::map<std::string, std::string>());
    description.parameters = json.contains("parameters") ? json["parameters"].dump() : "";
    return description;
  }
  catch (const nlohmann::json::exception& error)
  {
    // Without the library's own "[json.exception...] ".
    const std::string words = error.what();
    throw std::invalid_argument(std::string(kRunDescriptionTopic) + ": " + words.substr(words.find("] ") + 2) +
                                "; expected a JSON object with the texts setup and gold_standard, the number epoch_ns "
                                "and versions, as this project's programs record it");
  }
}

std::string ctFingerprint(const std::string& ct_path)
{
  std::vector<std::filesystem::path> files;
  if (std::filesystem::is_directory(ct_path))
  {
    for (const auto& entry : std::filesystem::directory_iterator(ct_path))
    {
      if (entry.is_regular_file())
      {
        files.push_back(entry.path());
      }
    }
    std::sort(files.begin(), files.end());
  }
  else if (std::filesystem::is_regular_file(ct_path))
  {
    files.emplace_back(ct_path);
  }
  boost::crc_32_type crc;
  std::uintmax_t bytes = 0;
  std::vector<char> buffer(1 << 16);
  for (const std::filesystem::path& path : files)
  {
    std::ifstream file(path, std::ios::binary);
    do
    {
      file.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
      crc.process_bytes(buffer.data(), static_cast<std::size_t>(file.gcount()));
      bytes += static_cast<std::uintmax_t>(file.gcount());
    } while (file);
  }
  if (bytes == 0)
  {
    return "";
  }
  char text[60];
  std::snprintf(text, sizeof(text), "%ju bytes, crc32 %08x", bytes, static_cast<unsigned>(crc.checksum()));
  return text;
}

Recording::Recording(const std::string& path) : path_(path), files_(partsOf(path))
{
  for (const std::string& part : files_)
  {
    try
    {
      bags_.push_back(std::make_unique<rosbag::Bag>(part, rosbag::bagmode::Read));
    }
    catch (const rosbag::BagUnindexedException&)
    {
      throw std::runtime_error(part + ": was not closed (no index), expected a complete bag: run rosbag reindex");
    }
    catch (const rosbag::BagException& error)
    {
      throw std::runtime_error(part + ": no bag, cut off or damaged, expected a complete one: " + error.what());
    }
  }
  const auto view = messages([](const rosbag::ConnectionInfo* connection)
                             { return lastName(connection->topic) == kRunDescriptionTopic; });
  for (const rosbag::MessageInstance& instance : *view)
  {
    if (const auto text = instance.instantiate<std_msgs::String>())
    {
      try
      {
        description_ = runDescriptionFromText(text->data);
      }
      catch (const std::invalid_argument& error)
      {
        throw std::runtime_error(path_ + ": " + error.what());
      }
    }
  }
}

std::unique_ptr<rosbag::View> Recording::messages(
    const std::function<bool(const rosbag::ConnectionInfo*)>& wanted) const
{
  auto view = std::make_unique<rosbag::View>();
  for (const std::unique_ptr<rosbag::Bag>& bag : bags_)
  {
    if (wanted)
    {
      view->addQuery(*bag, wanted);
    }
    else
    {
      view->addQuery(*bag);
    }
  }
  return view;
}

std::unique_ptr<rosbag::View> Recording::messages(const std::string& topic, const ros::Time& recorded) const
{
  auto view = std::make_unique<rosbag::View>();
  for (const std::unique_ptr<rosbag::Bag>& bag : bags_)
  {
    view->addQuery(*bag, rosbag::TopicQuery(topic), recorded, recorded);
  }
  return view;
}

TreatmentSetup Recording::setup(const std::string& setup_path) const
{
  if (!setup_path.empty())
  {
    return loadTreatmentSetup(setup_path);
  }
  if (!description_)
  {
    throw std::runtime_error(path_ + ": has no setup in it (no " + kRunDescriptionTopic +
                             "), expected --setup SETUP.yaml");
  }
  return treatmentSetupFromText(description_->setup, path_ + " (its own setup)");
}

std::string rawTopic(const std::string& topic)
{
  return lastName(topic) == "compressed" ? topic.substr(0, topic.rfind('/')) : topic;
}

std::string lastName(const std::string& topic)
{
  return topic.substr(topic.rfind('/') + 1);
}

std::string detectorOf(const std::string& topic)
{
  return lastName(topic.substr(0, topic.rfind('/')));
}

std::string cameraInfoDifference(const sensor_msgs::CameraInfo& info, const ProjectionGeometry& detector)
{
  if (const Eigen::Vector2i& size = detector.imageSize();
      info.width != static_cast<unsigned>(size.x()) || info.height != static_cast<unsigned>(size.y()))
  {
    return "size is " + std::to_string(info.width) + " x " + std::to_string(info.height) + ", expected " +
           std::to_string(size.x()) + " x " + std::to_string(size.y());
  }
  try
  {
    // By the nodes' own rules of what a camera_info may say.
    const ProjectionGeometry stated =
        geometryFromCameraInfo(detector.name(), info, detector.roomFromOptical(), detector.sourceToDetector());
    Eigen::Vector4d is, expected;
    is << stated.focalLength(), stated.foot();
    expected << detector.focalLength(), detector.foot();
    for (int i = 0; i < 4; ++i)
    {
      if (!(std::abs(is[i] - expected[i]) <= kProjectionTolerance))
      {
        constexpr std::array<const char*, 4> kNames{ "fx", "fy", "cx", "cy" };
        return kNames[i] + printed(" is %.4f px, expected %.4f", is[i], expected[i]);
      }
    }
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  return "";
}
}  // namespace xray_tracking
