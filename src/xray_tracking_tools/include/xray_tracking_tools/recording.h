#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Topic on which a recording says of itself what it is evaluated by: std_msgs/String, latched, a JSON object.
constexpr const char* kRunDescriptionTopic = "run_description";

/// What it says. Texts are as they stand in the files that they come from, so that no digit is lost.
struct RunDescription
{
  std::string setup;          ///< selfContainedSetup()
  std::string gold_standard;  ///< of a sequence: its table; empty if there is none
  std::int64_t epoch_ns = 0;  ///< what was added to the sequence's stamps
  std::string parameters;     ///< of the graph's nodes, JSON; empty if there was no graph
  /// Of this package set and what it was built with; of the CT's files, by which one knows them again.
  std::map<std::string, std::string> versions;
};

/// Of a setup file, with the versions of what runs here.
/// @throws std::runtime_error as loadTreatmentSetup()
RunDescription describeRun(const std::string& setup_path);
std::string textOf(const RunDescription& description);
/// @throws std::invalid_argument saying what is wrong
RunDescription runDescriptionFromText(const std::string& text);

/// Bytes and checksum of a CT's files, "90439680 bytes, crc32 1a2b3c4d": whether it is the same CT. Empty if there is
/// none.
std::string ctFingerprint(const std::string& ct_path);

/// A bag; or the bags of a recording that was split, of which the first, `x_0.bag`, stands for all.
class Recording
{
public:
  /// @throws std::runtime_error naming the file: none, no bag, one that was not closed
  explicit Recording(const std::string& path);

  const std::string& path() const { return path_; }
  /// Its bags, one if it was not split.
  const std::vector<std::string>& files() const { return files_; }

  /// All messages of the topics that are wanted, in the order in which they were recorded; empty: of all topics.
  /// Of the recording, which has to stay.
  std::unique_ptr<rosbag::View> messages(const std::function<bool(const rosbag::ConnectionInfo*)>& wanted = {}) const;
  /// Those of one topic that were recorded at one time.
  std::unique_ptr<rosbag::View> messages(const std::string& topic, const ros::Time& recorded) const;

  /// What it says of itself; none if it says nothing. @throws std::runtime_error naming the recording
  const std::optional<RunDescription>& description() const { return description_; }

  /// The setup of a file, or, where `setup_path` is empty, the one in the recording.
  /// @throws std::runtime_error naming what is wrong, or that there is none
  TreatmentSetup setup(const std::string& setup_path) const;

private:
  std::string path_;
  std::vector<std::string> files_;
  std::vector<std::unique_ptr<rosbag::Bag>> bags_;
  std::optional<RunDescription> description_;
};

/// `/room/detector_a/image_raw` of `/room/detector_a/image_raw/compressed`, as of itself
std::string rawTopic(const std::string& topic);
/// `image_raw` of `/room/detector_a/image_raw`
std::string lastName(const std::string& topic);
/// `detector_a` of it
std::string detectorOf(const std::string& topic);

/// In what a camera_info differs from the detector, beyond a thousandth of a pixel: "fx is 9400.0, expected 9500.0"; or
/// what makes it none that geometryFromCameraInfo() takes: distortion, binning, a K that is no pinhole's. Empty: in
/// nothing.
std::string cameraInfoDifference(const sensor_msgs::CameraInfo& info, const ProjectionGeometry& detector);
}  // namespace xray_tracking
