#include "xray_tracking_tools/recording_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <utility>

#include <tf2/buffer_core.h>
#include <tf2/exceptions.h>

#include "image_examination.h"
#include "pose_check.h"
#include "tally.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kClockTolerance = 1000000000;  // [ns], StampPolicy's
constexpr double kGap = 2.5;                          // of the usual interval: one exposure is missing, and more
constexpr std::size_t kFewStamps = 4;                 // less have no usual interval
constexpr double kTfDistance = 0.1;                   // [mm]
constexpr double kTfAngle = 1e-4;                     // [rad]
constexpr std::size_t kPending = 16;                  // exposures that may lack a view while they are looked through

std::string printed(const char* format, double a, double b = 0.0)
{
  char text[160];
  std::snprintf(text, sizeof(text), format, a, b);
  return text;
}

double median(std::vector<double> values)
{
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double seconds(std::int64_t ns)
{
  return 1e-9 * static_cast<double>(ns);
}

/// What is kept of one detector.
struct Detector
{
  std::vector<std::int64_t> stamps;  ///< of images, as recorded
  std::vector<std::int64_t> info_stamps;
  std::optional<sensor_msgs::CameraInfo> info;  ///< the first
  std::unique_ptr<ImageExamination> examination;
  cv::Size size;  ///< of the images
};
}  // namespace

struct RecordingCheck::Implementation
{
  std::optional<TreatmentSetup> setup;
  std::vector<std::string> names;
  std::map<std::string, Detector> detectors;
  std::map<std::int64_t, RigidTransform> gold_standard;
  Tally tally;
  std::map<std::string, std::size_t> totals;  ///< messages by what findings name
  std::vector<Finding> findings;
  tf2::BufferCore transforms;
  std::map<std::int64_t, std::map<std::string, cv::Mat>> pending;  ///< good images of exposures that lack others
  std::vector<cv::Mat> first;                                      ///< good images of the first complete exposure
  std::int64_t first_ns = 0;

  static std::string imagesOf(const std::string& detector) { return detector + "/image_raw"; }
  static std::string infosOf(const std::string& detector) { return detector + "/camera_info"; }

  void tell(const std::string& code, Severity severity, const std::string& thing, const std::string& value,
            const std::string& expected, const std::string& advice)
  {
    findings.push_back({ code, severity, thing, value, expected, advice });
  }

  void takeStamp(Detector& detector, const std::string& thing, std::int64_t stamp_ns)
  {
    ++totals[thing];
    if (!detector.stamps.empty())
    {
      const std::int64_t last = detector.stamps.back();
      if (stamp_ns < last)
      {
        tally.add("time_backward", thing, stamp_ns,
                  printed("by %.6f s, the farthest of them", seconds(last - stamp_ns)), seconds(last - stamp_ns));
      }
      else if (stamp_ns == last)
      {
        tally.add("stamp_repeated", thing, stamp_ns, "the stamp of the one before");
      }
    }
    detector.stamps.push_back(stamp_ns);
  }

  /// Keeps the images of the first exposure that is good in all views.
  void keepFirst(const std::string& name, std::int64_t stamp_ns, const cv::Mat& image)
  {
    if (!first.empty())
    {
      return;
    }
    std::map<std::string, cv::Mat>& images = pending[stamp_ns];
    images[name] = image.clone();
    if (images.size() == names.size())
    {
      for (const std::string& each : names)
      {
        first.push_back(images.at(each));
      }
      first_ns = stamp_ns;
      pending.clear();
    }
    else if (pending.size() > kPending)
    {
      pending.erase(pending.begin());
    }
  }

  void checkTransform(const std::string& name, std::int64_t stamp_ns)
  {
    if (!setup)
    {
      return;
    }
    try
    {
      const geometry_msgs::TransformStamped found =
          transforms.lookupTransform(kRoomFrame, opticalFrame(name), ros::Time(0));
      const RigidTransform expected = setup->detector(name).roomFromOptical();
      const RigidTransform difference = expected.inverse() * rigidFromTransformMsg(found.transform);
      const double distance = difference.translation().norm();
      const double angle = rotationAngle(difference);
      if (!(distance <= kTfDistance && angle <= kTfAngle))
      {
        tally.add("tf_differs", "tf " + std::string(kRoomFrame) + " -> " + opticalFrame(name), stamp_ns,
                  printed("%.3f mm and %.4f degrees from it", distance, angle * 180.0 / M_PI), distance);
      }
    }
    catch (const tf2::TransformException&)
    {
      // A recording of a driver alone has no tf.
    }
    catch (const std::invalid_argument& error)
    {
      tally.add("tf_differs", "tf " + std::string(kRoomFrame) + " -> " + opticalFrame(name), stamp_ns, error.what());
    }
  }

  void checkInfo(const std::string& name, const sensor_msgs::CameraInfo& info, std::int64_t stamp_ns)
  {
    const std::string thing = infosOf(name);
    Detector& detector = detectors.at(name);
    try
    {
      geometryFromCameraInfo(name, info, RigidTransform::Identity(), 1000.0);
    }
    catch (const std::invalid_argument& error)
    {
      tally.add("camera_info_invalid", thing, stamp_ns, error.what());
      return;
    }
    if (!detector.info)
    {
      detector.info = info;
    }
    if (info.K != detector.info->K || info.P != detector.info->P || info.width != detector.info->width ||
        info.height != detector.info->height)
    {
      tally.add("camera_info_changed", thing, stamp_ns,
                printed("fx is %.4f px, in the first one %.4f", info.P[0], detector.info->P[0]) +
                    printed(", cx %.4f and %.4f", info.P[2], detector.info->P[2]),
                std::abs(info.P[0] - detector.info->P[0]) + std::abs(info.P[2] - detector.info->P[2]));
    }
    if (info.header.frame_id != opticalFrame(name))
    {
      tally.add("camera_info_frame", thing, stamp_ns, "frame_id is '" + info.header.frame_id + "'");
    }
    if (!setup)
    {
      return;
    }
    const std::string difference = cameraInfoDifference(info, setup->detector(name));
    if (!difference.empty())
    {
      std::string like;
      for (const ProjectionGeometry& other : setup->detectors)
      {
        if (other.name() != name && cameraInfoDifference(info, other).empty())
        {
          like = "; it is that of " + other.name() + ": are the detectors swapped?";
        }
      }
      tally.add("camera_info_differs", thing, stamp_ns, difference + like);
    }
  }

  void checkPresence()
  {
    for (const std::string& name : names)
    {
      if (detectors.at(name).stamps.empty())
      {
        tell("topic_missing", Severity::ERROR, imagesOf(name), "has no message", "sensor_msgs/Image of every exposure",
             "record it, remap what the driver calls it, or name the detector in the setup as the driver does");
      }
      if (detectors.at(name).info_stamps.empty())
      {
        tell("topic_missing", Severity::ERROR, infosOf(name), "has no message",
             "sensor_msgs/CameraInfo of every exposure", "record it: it carries the projection");
      }
    }
  }

  /// Sorted, each once.
  static std::vector<std::int64_t> sorted(std::vector<std::int64_t> stamps)
  {
    std::sort(stamps.begin(), stamps.end());
    stamps.erase(std::unique(stamps.begin(), stamps.end()), stamps.end());
    return stamps;
  }

  /// [s]; 0 if there are too few
  static double usualInterval(const std::vector<std::int64_t>& stamps)
  {
    std::vector<double> intervals;
    for (std::size_t k = 1; k < stamps.size(); ++k)
    {
      intervals.push_back(seconds(stamps[k] - stamps[k - 1]));
    }
    return stamps.size() < kFewStamps ? 0.0 : median(std::move(intervals));
  }

  void checkGaps(const std::string& name, const std::vector<std::int64_t>& stamps)
  {
    const double usual = usualInterval(stamps);
    std::size_t count = 0;
    std::int64_t longest = 0, after = 0;
    for (std::size_t k = 1; usual > 0.0 && k < stamps.size(); ++k)
    {
      const std::int64_t interval = stamps[k] - stamps[k - 1];
      if (seconds(interval) > kGap * usual)
      {
        ++count;
        if (interval > longest)
        {
          longest = interval;
          after = stamps[k - 1];
        }
      }
    }
    if (count > 0)
    {
      tell("gap", Severity::WARNING, imagesOf(name),
           std::to_string(count) + " of " + std::to_string(stamps.size() - 1) + " intervals, the longest " +
               printed("%.3f s after ", seconds(longest)) + secondsText(after),
           printed("about %.3f s from one exposure to the next", usual),
           "look whether X-rays paused or messages were lost; the target may be elsewhere behind it");
    }
  }

  static double distanceToNearest(const std::vector<std::int64_t>& stamps, std::int64_t stamp)
  {
    const auto next = std::lower_bound(stamps.begin(), stamps.end(), stamp);
    double nearest = std::numeric_limits<double>::infinity();
    if (next != stamps.end())
    {
      nearest = seconds(*next - stamp);
    }
    if (next != stamps.begin())
    {
      nearest = std::min(nearest, seconds(stamp - *std::prev(next)));
    }
    return nearest;
  }

  /// Of two lists, what of the first has no equal in the second: stamped a little otherwise, or not there at all.
  struct Unpaired
  {
    std::vector<double> off;            ///< [s]
    std::vector<std::int64_t> missing;  ///< stamps
  };
  static Unpaired unpaired(const std::vector<std::int64_t>& stamps, const std::vector<std::int64_t>& others,
                           double usual_interval)
  {
    Unpaired result;
    const double near = usual_interval > 0.0 ? 0.5 * usual_interval : 0.1;
    for (const std::int64_t stamp : stamps)
    {
      const double off = distanceToNearest(others, stamp);
      if (off > 0.0 && off < near)
      {
        result.off.push_back(off);
      }
      else if (off > 0.0)
      {
        result.missing.push_back(stamp);
      }
    }
    return result;
  }

  void checkPairs(const std::map<std::string, std::vector<std::int64_t>>& stamps)
  {
    const std::string& reference = names.front();
    const double usual = usualInterval(stamps.at(reference));
    for (const std::string& name : names)
    {
      if (stamps.at(name).empty() || name == reference || stamps.at(reference).empty())
      {
        continue;
      }
      const Unpaired here = unpaired(stamps.at(name), stamps.at(reference), usual);
      const Unpaired there = unpaired(stamps.at(reference), stamps.at(name), usual);
      if (!here.off.empty())
      {
        const double most = *std::max_element(here.off.begin(), here.off.end());
        // What is farther apart the offline tools do not pair.
        tell("unpaired", most <= kPairingTolerance ? Severity::WARNING : Severity::ERROR, imagesOf(name),
             std::to_string(here.off.size()) + " of " + std::to_string(stamps.at(name).size()) + " stamps are " +
                 printed("%.6f s (median), at most %.6f s from those of ", median(here.off), most) +
                 imagesOf(reference),
             "the same stamp in all views of an exposure",
             printed("have one clock stamp both; if they are of one exposure, set motion_estimation's "
                     "pairing_tolerance to %.3g s",
                     1.1 * most));
      }
      const auto missing = [&](const std::string& who, const std::string& beside, const Unpaired& of)
      {
        if (!of.missing.empty())
        {
          tell("image_missing", 2 * of.missing.size() >= stamps.at(beside).size() ? Severity::ERROR : Severity::WARNING,
               imagesOf(who),
               "none for " + std::to_string(of.missing.size()) + " of " + std::to_string(stamps.at(beside).size()) +
                   " exposures of " + beside + ", the first at " + secondsText(of.missing.front()),
               "an image of every exposure", "look for lost messages; these exposures have no pose");
        }
      };
      missing(reference, name, here);
      missing(name, reference, there);
    }
  }

  void checkInfos(const std::map<std::string, std::vector<std::int64_t>>& stamps)
  {
    for (const std::string& name : names)
    {
      const std::vector<std::int64_t> infos = sorted(detectors.at(name).info_stamps);
      if (infos.empty())
      {
        continue;
      }
      std::size_t without = 0;
      std::int64_t first_without = 0;
      for (const std::int64_t stamp : stamps.at(name))
      {
        if (!std::binary_search(infos.begin(), infos.end(), stamp))
        {
          first_without = without++ == 0 ? stamp : first_without;
        }
      }
      if (without > 0)
      {
        tell("camera_info_unpaired", 2 * without >= stamps.at(name).size() ? Severity::ERROR : Severity::WARNING,
             infosOf(name),
             "none for " + std::to_string(without) + " of " + std::to_string(stamps.at(name).size()) +
                 " images, the first at " + secondsText(first_without) +
                 printed(", where the nearest is %.6f s off", distanceToNearest(infos, first_without)),
             "one with the stamp of every image", "have the driver publish both with one stamp");
      }
    }
  }

  void checkGoldStandard(const std::vector<std::int64_t>& stamps)
  {
    std::size_t without = 0;
    std::int64_t first_without = 0;
    for (const std::int64_t stamp : stamps)
    {
      if (gold_standard.count(stamp) == 0)
      {
        first_without = without++ == 0 ? stamp : first_without;
      }
    }
    if (!gold_standard.empty() && without > 0)
    {
      tell("gold_standard_incomplete", Severity::WARNING, "gold standard",
           "none for " + std::to_string(without) + " of " + std::to_string(stamps.size()) +
               " exposures, the first at " + secondsText(first_without),
           "a pose of every exposure, or none at all", "complete it: errors are not judged without");
    }
  }
};

RecordingCheck::RecordingCheck(std::optional<TreatmentSetup> setup, std::vector<std::string> detectors)
  : implementation_(std::make_unique<Implementation>())
{
  Implementation& i = *implementation_;
  i.setup = std::move(setup);
  i.names = std::move(detectors);
  for (const std::string& name : i.names)
  {
    cv::Rect target;
    if (i.setup)
    {
      const auto region = i.setup->regions.find(name);
      target =
          region != i.setup->regions.end() ? region->second : projectedTargetRegion(*i.setup, i.setup->detector(name));
    }
    i.detectors[name].examination = std::make_unique<ImageExamination>(
        Implementation::imagesOf(name), i.setup ? i.setup->intensity : IntensityModel(), target);
  }
}

RecordingCheck::~RecordingCheck() = default;

void RecordingCheck::addImage(const std::string& name, std::int64_t stamp_ns, const cv::Mat& image)
{
  Implementation& i = *implementation_;
  const auto found = i.detectors.find(name);
  if (found == i.detectors.end())
  {
    return;
  }
  Detector& detector = found->second;
  const std::string thing = Implementation::imagesOf(name);
  i.takeStamp(detector, thing, stamp_ns);
  cv::Size expected = detector.size;
  if (i.setup)
  {
    const Eigen::Vector2i& size = i.setup->detector(name).imageSize();
    expected = { size.x(), size.y() };
  }
  else if (detector.info)
  {
    expected = { static_cast<int>(detector.info->width), static_cast<int>(detector.info->height) };
  }
  detector.size = image.size();
  if (!expected.empty() && expected != image.size())
  {
    i.tally.add("image_size", thing, stamp_ns,
                std::to_string(image.cols) + " x " + std::to_string(image.rows) + " px, not " +
                    std::to_string(expected.width) + " x " + std::to_string(expected.height));
    return;
  }
  if (detector.examination->add(image, stamp_ns, i.tally))
  {
    i.keepFirst(name, stamp_ns, image);
  }
}

void RecordingCheck::addBadImage(const std::string& name, std::int64_t stamp_ns, const std::string& code,
                                 const std::string& why)
{
  const auto found = implementation_->detectors.find(name);
  if (found != implementation_->detectors.end())
  {
    implementation_->takeStamp(found->second, Implementation::imagesOf(name), stamp_ns);
    implementation_->tally.add(code, Implementation::imagesOf(name), stamp_ns, why);
  }
}

void RecordingCheck::addCameraInfo(const std::string& name, const sensor_msgs::CameraInfo& info)
{
  const auto found = implementation_->detectors.find(name);
  if (found != implementation_->detectors.end())
  {
    const std::int64_t stamp_ns = nanosecondsFromTime(info.header.stamp);
    ++implementation_->totals[Implementation::infosOf(name)];
    found->second.info_stamps.push_back(stamp_ns);
    implementation_->checkInfo(name, info, stamp_ns);
    implementation_->checkTransform(name, stamp_ns);
  }
}

void RecordingCheck::addTransforms(const tf2_msgs::TFMessage& message, bool fixed)
{
  for (const geometry_msgs::TransformStamped& transform : message.transforms)
  {
    // Of the detectors alone: there are many others.
    if (transform.child_frame_id != kPatientFrame && transform.child_frame_id != kGroundTruthFrame)
    {
      implementation_->transforms.setTransform(transform, "recording", fixed);
    }
  }
}

void RecordingCheck::addGoldStandard(std::int64_t stamp_ns, const RigidTransform& room_from_patient)
{
  implementation_->gold_standard[stamp_ns] = room_from_patient;
}

void RecordingCheck::addRecorded(const std::string& topic, std::int64_t stamp_ns, std::int64_t recorded_ns)
{
  const std::int64_t ahead = stamp_ns - recorded_ns;
  if (stamp_ns == 0)
  {
    implementation_->tally.add("stamp_zero", topic, recorded_ns, "no time");
  }
  else if (std::abs(ahead) > kClockTolerance)
  {
    implementation_->tally.add(ahead > 0 ? "stamp_ahead" : "stamp_behind", topic, stamp_ns,
                               printed("by %.3f s at most", std::abs(seconds(ahead))), std::abs(seconds(ahead)));
  }
}

void RecordingCheck::add(Finding finding)
{
  implementation_->findings.push_back(std::move(finding));
}

std::vector<Finding> RecordingCheck::finish()
{
  Implementation& i = *implementation_;
  i.checkPresence();
  std::map<std::string, std::vector<std::int64_t>> stamps;
  for (const std::string& name : i.names)
  {
    stamps[name] = Implementation::sorted(i.detectors.at(name).stamps);
    i.checkGaps(name, stamps[name]);
    i.checkTransform(name, stamps[name].empty() ? 0 : stamps[name].back());
  }
  if (!i.names.empty())
  {
    i.checkPairs(stamps);
    i.checkInfos(stamps);
    i.checkGoldStandard(stamps.at(i.names.front()));
  }
  const std::vector<Finding> tallied = i.tally.findings(i.totals);
  i.findings.insert(i.findings.end(), tallied.begin(), tallied.end());
  if (i.setup)
  {
    std::optional<RigidTransform> gold;
    if (!i.gold_standard.empty())
    {
      const auto there = i.gold_standard.find(i.first_ns);
      gold = there != i.gold_standard.end() ? there->second : i.gold_standard.begin()->second;
    }
    const std::vector<Finding> of_pose = checkPose(*i.setup, i.first, gold);
    i.findings.insert(i.findings.end(), of_pose.begin(), of_pose.end());
  }
  std::stable_sort(i.findings.begin(), i.findings.end(),
                   [](const Finding& a, const Finding& b) { return a.severity > b.severity; });
  return std::move(i.findings);
}
}  // namespace xray_tracking
