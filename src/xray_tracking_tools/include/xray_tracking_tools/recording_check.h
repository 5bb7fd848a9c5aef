#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <tf2_msgs/TFMessage.h>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_tools/finding.h"

namespace xray_tracking
{
/// Examines a recording as a stream of what it holds, in the order in which it was recorded. Keeps stamps and poses,
/// some ten bytes an exposure, and of the images those of the first exposure alone.
///
/// What a detector's image says is judged by the classes by which trackers and registration judge it, the pose in the
/// first exposure by the registration.
class RecordingCheck
{
public:
  /// @param setup what the recording is compared with; none: it is examined by itself
  /// @param detectors names; those of the setup if there is one
  RecordingCheck(std::optional<TreatmentSetup> setup, std::vector<std::string> detectors);
  ~RecordingCheck();
  RecordingCheck(const RecordingCheck&) = delete;
  RecordingCheck& operator=(const RecordingCheck&) = delete;

  // Of a detector that is none of `detectors` nothing is taken in.
  /// @param image CV_8UC1 or CV_16UC1
  void addImage(const std::string& detector, std::int64_t stamp_ns, const cv::Mat& image);
  /// An exposure whose image cannot be read. @param code of the finding; @param why in words
  void addBadImage(const std::string& detector, std::int64_t stamp_ns, const std::string& code, const std::string& why);
  void addCameraInfo(const std::string& detector, const sensor_msgs::CameraInfo& info);
  /// @param fixed of `/tf_static`
  void addTransforms(const tf2_msgs::TFMessage& message, bool fixed);
  void addGoldStandard(std::int64_t stamp_ns, const RigidTransform& room_from_patient);
  /// That a message was recorded at a time which its stamp does not fit, if it does not.
  void addRecorded(const std::string& topic, std::int64_t stamp_ns, std::int64_t recorded_ns);

  /// What whoever reads the recording has found.
  void add(Finding finding);

  /// All that was found, errors first. Reads the CT, which takes seconds. Once, at the end.
  std::vector<Finding> finish();

private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

/// Of a bag, or a recording that was split. @param setup_path empty: the setup in the recording; if it has none, what
/// can be told without
/// Never throws for what is wrong with the recording: that is a finding.
std::vector<Finding> checkBag(const std::string& bag_path, const std::string& setup_path);

/// Of a sequence folder, also one that loadSequence() refuses.
std::vector<Finding> checkSequence(const std::string& folder);
}  // namespace xray_tracking
