// Readers of messages, and of what a bag holds.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <optional>
#include <stdexcept>

#include <geometry_msgs/PoseStamped.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <std_msgs/String.h>
#include <tf2_msgs/TFMessage.h>
#include <xray_tracking_msgs/RefinementRequest.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "reader_tools.h"
#include "ros/tracked_view_message.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/region_patch.h"
#include "xray_tracking_registration/refinement_messages.h"
#include "xray_tracking_tools/bag_sequence.h"
#include "xray_tracking_tools/recording.h"
#include "xray_tracking_tools/recording_check.h"

namespace xray_tracking
{
namespace
{
void readRunDescription(const std::string& bytes)
{
  expected_name = kRunDescriptionTopic;
  const RunDescription description = runDescriptionFromText(bytes);
  treatmentSetupFromText(description.setup, kRunDescriptionTopic);
}

/// Fields of a message, one after the other. What is not there is zero. (As roscpp serialises them they are not taken:
/// it makes room for as many elements as a message claims before it looks for them.)
class Fields
{
public:
  explicit Fields(const std::string& bytes) : bytes_(bytes) {}

  template <typename Number>
  void read(Number& number)
  {
    number = Number();
    const std::size_t count = std::min(sizeof(number), bytes_.size() - at_);
    std::memcpy(&number, bytes_.data() + at_, count);
    at_ += count;
  }

  template <typename Numbers>
  void readAll(Numbers& numbers)
  {
    for (auto& number : numbers)
    {
      read(number);
    }
  }

  void read(std::string& text)
  {
    std::uint8_t length = 0;
    read(length);
    text = bytes_.substr(at_, length);
    at_ += text.size();
  }

  void read(geometry_msgs::Pose& pose)
  {
    for (double* number : { &pose.position.x, &pose.position.y, &pose.position.z, &pose.orientation.x,
                            &pose.orientation.y, &pose.orientation.z, &pose.orientation.w })
    {
      read(*number);
    }
  }

  void read(sensor_msgs::RegionOfInterest& region)
  {
    read(region.x_offset);
    read(region.y_offset);
    read(region.width);
    read(region.height);
  }

  void read(ros::Time& time)
  {
    read(time.sec);
    read(time.nsec);
    time.nsec %= 1000000000;
  }

  /// Of an image, or of a file that is one.
  void read(std::vector<std::uint8_t>& data)
  {
    std::uint16_t length = 0;
    read(length);
    const std::string text = bytes_.substr(at_, length);
    data.assign(text.begin(), text.end());
    at_ += text.size();
  }

  bool more() const { return at_ < bytes_.size(); }

private:
  const std::string& bytes_;
  std::size_t at_ = 0;
};

void requireReadable(const cv::Mat& pixels)
{
  require(pixels.depth() <= CV_16U && cv::countNonZero(pixels) <= static_cast<int>(pixels.total()), "has no pixels");
}

sensor_msgs::Image imageOf(Fields& fields)
{
  sensor_msgs::Image message;
  fields.read(message.height);
  fields.read(message.width);
  fields.read(message.is_bigendian);
  fields.read(message.step);
  fields.read(message.encoding);
  fields.read(message.data);
  return message;
}

void readImageMessage(const std::string& bytes)
{
  expected_name = "image";
  Fields fields(bytes);
  requireReadable(pixelsFromMsg(imageOf(fields)));
}

sensor_msgs::CompressedImage compressedImageOf(Fields& fields)
{
  sensor_msgs::CompressedImage message;
  fields.read(message.format);
  fields.read(message.data);
  return message;
}

void readCompressedImage(const std::string& bytes)
{
  expected_name = "image.format";
  Fields fields(bytes);
  requireReadable(pixelsFromMsg(compressedImageOf(fields)));
}

sensor_msgs::CameraInfo cameraInfoOf(Fields& fields)
{
  sensor_msgs::CameraInfo message;
  fields.read(message.height);
  fields.read(message.width);
  fields.readAll(message.K);
  fields.readAll(message.R);
  fields.readAll(message.P);
  fields.read(message.binning_x);
  fields.read(message.binning_y);
  fields.read(message.roi);
  fields.read(message.distortion_model);
  std::uint8_t coefficients = 0;
  fields.read(coefficients);
  message.D.resize(coefficients);
  fields.readAll(message.D);
  return message;
}

void readCameraInfo(const std::string& bytes)
{
  expected_name = "";
  Fields fields(bytes);
  const ProjectionGeometry& detector = setup().detectors[0];
  const ProjectionGeometry geometry = geometryFromCameraInfo(detector.name(), cameraInfoOf(fields),
                                                             detector.roomFromOptical(), detector.sourceToDetector());
  require(geometry.project({ 0.0, 0.0, 0.0 }).allFinite(), "it projects nothing");
}

std::optional<ViewMeasurement> measurementOf(const std::string& bytes)
{
  xray_tracking_msgs::TrackedRegion message;
  Fields fields(bytes);
  fields.read(message.state);
  fields.read(message.model);
  fields.read(message.reference_stamp.sec);
  fields.read(message.reference_stamp.nsec);
  fields.read(message.region);
  fields.read(message.displacement_x);
  fields.read(message.displacement_y);
  fields.readAll(message.linear);
  fields.readAll(message.covariance);
  fields.read(message.fault);
  const TrackedView view = trackedViewFromMsg(message, 0);
  const bool found = view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED;
  return found ? std::make_optional(ViewMeasurement{ setup().room_from_patient, view.track }) : std::nullopt;
}

void readTrackedRegion(const std::string& bytes)
{
  static const MotionEstimator estimator({}, setup().detectors, setup().targetCentre(),
                                         TargetShape::isotropic(setup().targetCentre()), setup().room_from_patient);
  const MotionEstimate estimate =
      estimator.estimate({ measurementOf(bytes), measurementOf(corpusFile("corpus/tracked_region/found")) });
  require((estimate.status == EstimateStatus::OK) == estimate.reason.empty(), "its status and reason contradict");
  require(isRigid(estimate.room_from_patient) && estimate.covariance.allFinite() &&
              estimate.pose_covariance.allFinite() && estimate.translation.allFinite() && estimate.rotation.allFinite(),
          "the estimate is not finite");
  if (estimate.status != EstimateStatus::OK)
  {
    throw std::runtime_error(expected_name + estimate.reason);
  }
}

void readRefinementRequest(const std::string& bytes)
{
  xray_tracking_msgs::RefinementRequest message;
  Fields fields(bytes);
  fields.read(message.seed);
  fields.read(message.max_translation);
  fields.read(message.max_rotation);
  fields.read(message.time_budget);
  fields.read(message.search);
  std::uint8_t regions = 0;
  fields.read(regions);
  message.regions.resize(regions);
  for (sensor_msgs::RegionOfInterest& region : message.regions)
  {
    fields.read(region);
  }
  expected_name = "";
  RegistrationRequest request;
  for (const ProjectionGeometry& detector : setup().detectors)
  {
    request.views.push_back({ detector, cv::Mat(6, 8, CV_16UC1, cv::Scalar(1000)) });
  }
  request.search = searchOf(message);
  applyRequest(message, setup(), request);
  require(isRigid(request.room_from_patient), "its seed is not rigid");
}

/// What a bag holds: when its sequence begins, and messages. How it holds it is not from outside, as rosbag looks where
/// a bag's bytes say, wherever that is.
void readRecording(const std::string& bytes)
{
  const std::string path = folder() + "/record.bag";
  expected_name = path;
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  Fields fields(bytes);
  RunDescription description;
  description.setup = runDescriptionFromText(corpusFile("corpus/run_description/plain")).setup;
  fields.read(description.epoch_ns);
  std_msgs::String text;
  text.data = textOf(description);
  bag.write("/run_description", ros::TIME_MIN, text);
  while (fields.more())
  {
    std::uint8_t kind = 0;
    std_msgs::Header header;
    ros::Time recorded;
    fields.read(kind);
    fields.read(header.stamp);
    fields.read(recorded);
    recorded = std::max(recorded, ros::TIME_MIN);  // rosbag takes no others
    const std::string detector = kind % 2 == 0 ? "/detector_a" : "/detector_b";
    const auto write = [&](const std::string& topic, auto message)
    {
      message.header = header;
      bag.write(topic, recorded, message);
    };
    switch (kind / 2 % 5)
    {
      case 0:
        write(detector + "/image_raw", imageOf(fields));
        break;
      case 1:
        write(detector + "/image_raw/compressed", compressedImageOf(fields));
        break;
      case 2:
        write(detector + "/camera_info", cameraInfoOf(fields));
        break;
      case 3:
      {
        geometry_msgs::PoseStamped truth;
        fields.read(truth.pose);
        write("/patient_ground_truth", truth);
        break;
      }
      default:
      {
        tf2_msgs::TFMessage message;
        message.transforms.resize(1);
        geometry_msgs::TransformStamped& transform = message.transforms[0];
        transform.header = header;
        fields.read(transform.header.frame_id);
        fields.read(transform.child_frame_id);
        geometry_msgs::Pose pose;
        fields.read(pose);
        transform.transform.translation.x = pose.position.x;
        transform.transform.translation.y = pose.position.y;
        transform.transform.translation.z = pose.position.z;
        transform.transform.rotation = pose.orientation;
        bag.write(kind % 2 == 0 ? "/tf" : "/tf_static", recorded, message);
      }
    }
  }
  bag.close();
  const Recording recording(path);
  for (const Finding& finding : checkBag(path, ""))
  {
    require(finding.code != "recording_unreadable", "its check gave up");
  }
  const std::string extracted = folder() + "/extracted";
  std::filesystem::remove_all(extracted);
  writeSequenceFolder(recording, "", extracted);
  loadSequence(extracted);  // refuses nothing of it
}

}  // namespace

std::vector<Reader> messageReaders()
{
  return { { "run_description", readRunDescription },
           { "image", readImageMessage },
           { "compressed_image", readCompressedImage },
           { "camera_info", readCameraInfo },
           { "tracked_region", readTrackedRegion },
           { "refinement_request", readRefinementRequest },
           { "recording", readRecording } };
}
}  // namespace xray_tracking
