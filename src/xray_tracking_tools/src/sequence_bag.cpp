#include "xray_tracking_tools/sequence_bag.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>

#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/String.h>
#include <boost/make_shared.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_tools/image_message.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
/// What bag_to_sequence needs to get everything back; and, once more at the end, when the next exposure would be, so
/// that a player that begins anew there leaves time for the last one.
void writeDescription(const Sequence& sequence, rosbag::Bag& bag)
{
  RunDescription description = describeRun(sequence.tables.front());
  description.epoch_ns = kPlaybackEpochNs;
  if (!sequence.gold_standard.empty())
  {
    std::ifstream file(sequence.tables.back(), std::ios::binary);
    description.gold_standard = { std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>() };
  }
  std_msgs::String message;
  message.data = textOf(description);
  const auto latched = boost::make_shared<ros::M_string>(
      ros::M_string{ { "latching", "1" },
                     { "type", ros::message_traits::datatype(message) },
                     { "md5sum", ros::message_traits::md5sum(message) },
                     { "message_definition", ros::message_traits::definition(message) } });
  const std::vector<Exposure>& exposures = sequence.exposures;
  const std::int64_t last = exposures.back().stamp_ns;
  const std::int64_t next = exposures.size() > 1 ? 2 * last - exposures[exposures.size() - 2].stamp_ns : last;
  for (const std::int64_t stamp_ns : { exposures.front().stamp_ns, next })
  {
    bag.write(std::string("/") + kRunDescriptionTopic, playbackTime(stamp_ns), message, latched);
  }
}

void writeExposures(const Sequence& sequence, rosbag::Bag& bag,
                    const std::function<void(std::size_t, std::size_t)>& progress)
{
  std::vector<sensor_msgs::CameraInfo> camera_infos;
  for (const ProjectionGeometry& detector : sequence.setup.detectors)
  {
    camera_infos.push_back(cameraInfoFromGeometry(detector));
  }
  for (std::size_t k = 0; k < sequence.exposures.size(); ++k)
  {
    const Exposure& exposure = sequence.exposures[k];
    const ros::Time stamp = playbackTime(exposure.stamp_ns);
    for (std::size_t d = 0; d < camera_infos.size(); ++d)
    {
      const ProjectionGeometry& detector = sequence.setup.detectors[d];
      camera_infos[d].header.stamp = stamp;
      bag.write("/" + detector.name() + "/camera_info", stamp, camera_infos[d]);
      bag.write("/" + detector.name() + "/image_raw", stamp,
                imageMessage(sequence.image(k, d), detector.name(), stamp));
    }
    if (!sequence.gold_standard.empty())
    {
      geometry_msgs::PoseStamped truth;
      truth.header.stamp = stamp;
      truth.header.frame_id = kRoomFrame;
      truth.pose = poseMsgFromRigid(sequence.gold_standard[k].room_from_patient);
      bag.write("/patient_ground_truth", stamp, truth);
    }
    progress(k + 1, sequence.exposures.size());
  }
}
}  // namespace

ros::Time playbackTime(std::int64_t stamp_ns)
{
  constexpr std::int64_t kLatestNs = std::numeric_limits<std::uint32_t>::max() * 1000000000LL;
  if (stamp_ns <= -kPlaybackEpochNs || stamp_ns > kLatestNs - kPlaybackEpochNs)
  {
    throw std::invalid_argument("stamp_s " + std::to_string(stamp_ns * 1e-9) +
                                " does not fit into ROS time: expected " + "more than -1000 and less than 4294966295");
  }
  return timeFromNanoseconds(stamp_ns + kPlaybackEpochNs);
}

void keepFirstExposures(Sequence& sequence, int frames)
{
  const std::size_t count = sequence.exposures.size();
  if (frames < 1 || static_cast<std::size_t>(frames) > count)
  {
    throw std::invalid_argument("frames is " + std::to_string(frames) + ", but the sequence has " +
                                std::to_string(count) + " exposures");
  }
  sequence.exposures.resize(frames);
  sequence.gold_standard.resize(std::min<std::size_t>(frames, sequence.gold_standard.size()));
}

void writeSequenceBag(const Sequence& sequence, const std::string& bag_path,
                      const std::function<void(std::size_t, std::size_t)>& progress)
{
  const std::string partial_path = bag_path + ".partial";
  try
  {
    rosbag::Bag bag(partial_path, rosbag::bagmode::Write);
    writeDescription(sequence, bag);
    writeExposures(sequence, bag, progress);
    bag.close();
    std::filesystem::rename(partial_path, bag_path);
  }
  catch (const rosbag::BagException& e)
  {
    std::remove(partial_path.c_str());
    throw std::runtime_error(bag_path + ": " + e.what());
  }
  catch (...)
  {
    std::remove(partial_path.c_str());
    throw;
  }
}
}  // namespace xray_tracking
