#include <algorithm>
#include <filesystem>
#include <set>
#include <stdexcept>

#include <geometry_msgs/PoseStamped.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_tools/recording.h"
#include "xray_tracking_tools/recording_check.h"

namespace xray_tracking
{
namespace
{
namespace encodings = sensor_msgs::image_encodings;

std::vector<std::string> namesOf(const TreatmentSetup& setup)
{
  std::vector<std::string> names;
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    names.push_back(detector.name());
  }
  return names;
}

Finding typeFinding(const rosbag::MessageInstance& instance, const std::string& expected)
{
  return { "topic_type",
           Severity::ERROR,
           instance.getTopic(),
           "is " + instance.getDataType(),
           expected,
           "record the driver's own topic, not a converted one" };
}

/// Gives a bag's messages to the check.
class BagExaminer
{
public:
  BagExaminer(const Recording& recording, std::optional<TreatmentSetup> setup)
    : recording_(recording), check_(setup, setup ? namesOf(*setup) : namesInBag())
  {
    if (setup)
    {
      names_ = namesOf(*setup);
    }
    else
    {
      names_ = namesInBag();
      check_.add({ "setup_missing", Severity::WARNING, recording.path(), "has no setup in it, and none was given",
                   "detectors, CT, initial pose and target box to compare with", "give --setup SETUP.yaml" });
      if (names_.empty())
      {
        check_.add({ "topic_missing", Severity::ERROR, recording.path(), "no topic <detector>/image_raw",
                     "two or more of sensor_msgs/Image", "record the detectors' images, or remap their topics" });
      }
    }
  }

  std::vector<Finding> run()
  {
    const auto view = recording_.messages();
    for (const rosbag::MessageInstance& instance : *view)
    {
      const std::string name = lastName(rawTopic(instance.getTopic()));
      if (name == "image_raw")
      {
        takeImage(instance);
      }
      else if (name == "camera_info")
      {
        takeCameraInfo(instance);
      }
      else if (name == "tf" || name == "tf_static")
      {
        if (const auto message = instance.instantiate<tf2_msgs::TFMessage>())
        {
          check_.addTransforms(*message, name == "tf_static");
        }
      }
      else if (name == "patient_ground_truth")
      {
        takeTruth(instance);
      }
    }
    for (const std::string& name : unknown_)
    {
      check_.add({ "detector_unknown", Severity::WARNING, name + "/image_raw", "the setup has no such detector",
                   "the setup's detectors", "name it in the setup, or leave it out of the recording" });
    }
    checkDescription();
    return check_.finish();
  }

private:
  std::vector<std::string> namesInBag() const
  {
    std::set<std::string> names;
    const auto view = recording_.messages();
    for (const rosbag::ConnectionInfo* connection : view->getConnections())
    {
      const std::string topic = rawTopic(connection->topic);
      if (lastName(topic) == "image_raw")
      {
        names.insert(detectorOf(topic));
      }
    }
    return { names.begin(), names.end() };
  }

  bool once(const std::string& topic) { return told_.insert(topic).second; }

  void takeImage(const rosbag::MessageInstance& instance)
  {
    const std::string detector = detectorOf(rawTopic(instance.getTopic()));
    if (std::find(names_.begin(), names_.end(), detector) == names_.end())
    {
      unknown_.insert(detector);
      return;
    }
    const auto image = instance.instantiate<sensor_msgs::Image>();
    const auto compressed = image ? nullptr : instance.instantiate<sensor_msgs::CompressedImage>();
    if (!image && !compressed)
    {
      if (once(instance.getTopic()))
      {
        check_.add(typeFinding(instance, "sensor_msgs/Image"));
      }
      return;
    }
    const std::int64_t stamp_ns = nanosecondsFromTime(image ? image->header.stamp : compressed->header.stamp);
    check_.addRecorded(detector + "/image_raw", stamp_ns, nanosecondsFromTime(instance.getTime()));
    if (image && image->encoding != encodings::MONO16 && image->encoding != encodings::MONO8 &&
        image->encoding != encodings::TYPE_16UC1 && image->encoding != encodings::TYPE_8UC1)
    {
      check_.addBadImage(detector, stamp_ns, "image_encoding", "encoding is '" + image->encoding + "'");
      return;
    }
    cv::Mat pixels;
    try
    {
      pixels = image ? pixelsFromMsg(*image) : pixelsFromMsg(*compressed);
    }
    catch (const std::exception& error)
    {
      check_.addBadImage(detector, stamp_ns, "image_unreadable", error.what());
      return;
    }
    check_.addImage(detector, stamp_ns, pixels);
  }

  void takeCameraInfo(const rosbag::MessageInstance& instance)
  {
    const std::string detector = detectorOf(instance.getTopic());
    if (const auto info = instance.instantiate<sensor_msgs::CameraInfo>())
    {
      check_.addCameraInfo(detector, *info);
    }
    else if (std::find(names_.begin(), names_.end(), detector) != names_.end() && once(instance.getTopic()))
    {
      check_.add(typeFinding(instance, "sensor_msgs/CameraInfo"));
    }
  }

  void takeTruth(const rosbag::MessageInstance& instance)
  {
    const auto truth = instance.instantiate<geometry_msgs::PoseStamped>();
    if (!truth)
    {
      if (once(instance.getTopic()))
      {
        check_.add(typeFinding(instance, "geometry_msgs/PoseStamped"));
      }
      return;
    }
    try
    {
      check_.addGoldStandard(nanosecondsFromTime(truth->header.stamp), rigidFromPoseMsg(truth->pose));
    }
    catch (const std::invalid_argument& error)
    {
      if (once(instance.getTopic()))
      {
        check_.add({ "gold_standard_invalid", Severity::ERROR, instance.getTopic(), error.what(),
                     "a finite pose with a quaternion of norm 1", "mend what publishes it, or leave it out" });
      }
    }
  }

  /// Whether the CT is still the one that the recording was made with.
  void checkDescription()
  {
    if (!recording_.description())
    {
      return;
    }
    const RunDescription& description = *recording_.description();
    const auto then = description.versions.find("ct");
    const std::string path = treatmentSetupFromText(description.setup, recording_.path()).ct_path;
    const std::string now = ctFingerprint(path);
    if (then != description.versions.end() && !now.empty() && now != then->second)
    {
      check_.add({ "ct_changed", Severity::ERROR, path, "has " + now, then->second + ", as when it was recorded",
                   "find the CT of the recording, and name it in a setup for --setup" });
    }
  }

  const Recording& recording_;
  std::vector<std::string> names_;
  RecordingCheck check_;
  std::set<std::string> unknown_;
  std::set<std::string> told_;
};
}  // namespace

std::vector<Finding> checkBag(const std::string& bag_path, const std::string& setup_path)
{
  try
  {
    const Recording recording(bag_path);
    std::optional<TreatmentSetup> setup;
    if (!setup_path.empty() || recording.description())
    {
      setup = recording.setup(setup_path);
    }
    return BagExaminer(recording, std::move(setup)).run();
  }
  catch (const std::exception& error)
  {
    return { { "recording_unreadable", Severity::ERROR, bag_path, error.what(), "a complete bag, and a setup file",
               "rosbag reindex mends a bag that was not closed; see docs/playback.md for the setup" } };
  }
}

std::vector<Finding> checkSequence(const std::string& folder)
{
  const std::string path = (std::filesystem::path(folder) / "sequence.yaml").string();
  try
  {
    const TreatmentSetup setup = loadTreatmentSetup(path);
    const std::vector<LensDistortion> distortions = loadDistortions(path, setup.detectors);
    const std::vector<FrameRow> rows = loadFrameTable(folder);
    RecordingCheck check(setup, namesOf(setup));
    std::set<std::string> unknown;
    for (const FrameRow& row : rows)
    {
      const auto detector = std::find_if(setup.detectors.begin(), setup.detectors.end(),
                                         [&](const ProjectionGeometry& each) { return each.name() == row.detector; });
      if (detector == setup.detectors.end())
      {
        if (unknown.insert(row.detector).second)
        {
          check.add({ "detector_unknown", Severity::ERROR, row.where,
                      "detector '" + row.detector + "' is none of the setup's", "a detector that sequence.yaml names",
                      "mend the name" });
        }
        continue;
      }
      sensor_msgs::CameraInfo info = cameraInfoFromGeometry(*detector);
      info.header.stamp = timeFromNanoseconds(row.stamp_ns);
      check.addCameraInfo(row.detector, info);
      try
      {
        check.addImage(row.detector, row.stamp_ns,
                       distortions[detector - setup.detectors.begin()].undo(
                           readXrayImage(row.file, *detector, setup.intensity), setup.intensity.kind));
      }
      catch (const std::exception& error)
      {
        check.addBadImage(row.detector, row.stamp_ns, "image_unreadable", error.what());
      }
    }
    const std::string gold_path = goldStandardPath(folder);
    if (!gold_path.empty())
    {
      try
      {
        for (const StampedPose& pose : loadPoses(gold_path))
        {
          check.addGoldStandard(pose.stamp_ns, pose.room_from_patient);
        }
      }
      catch (const std::runtime_error& error)
      {
        check.add({ "gold_standard_invalid", Severity::ERROR, gold_path, error.what(),
                    "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw with stamps that grow", "mend the line" });
      }
    }
    return check.finish();
  }
  catch (const std::exception& error)
  {
    return { { "recording_unreadable", Severity::ERROR, path, error.what(), "a sequence folder (docs/playback.md)",
               "mend the file" } };
  }
}
}  // namespace xray_tracking
