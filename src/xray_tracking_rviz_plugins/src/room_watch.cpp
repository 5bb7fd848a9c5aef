#include "room_watch.h"

#include <algorithm>
#include <chrono>

#include <ros/master.h>
#include <ros/this_node.h>
#include <boost/filesystem.hpp>

#include "xray_tracking_core/volume/data_folder.h"

namespace xray_tracking
{
namespace
{
constexpr std::chrono::seconds kPeriod(1);
const std::string kImage = "/image_raw";
/// Nodes that are given the setup file; one of them is there in every launch file.
constexpr const char* kSetupParameters[] = { "motion_estimation/setup_file", "treatment_room_publisher/setup_file",
                                             "registration/setup_file", "detector_simulator/setup_file" };
}  // namespace

std::vector<std::string> detectorsOf(const std::vector<std::string>& topics, const std::string& name_space)
{
  const std::string prefix = name_space.empty() || name_space.back() != '/' ? name_space + "/" : name_space;
  std::vector<std::string> detectors;
  for (const std::string& topic : topics)
  {
    if (topic.size() <= kImage.size() + 1 || topic.compare(topic.size() - kImage.size(), kImage.size(), kImage) != 0)
    {
      continue;
    }
    const std::string name = topic.substr(0, topic.size() - kImage.size());
    detectors.push_back(name.compare(0, prefix.size(), prefix) == 0 ? name.substr(prefix.size()) : name);
  }
  std::sort(detectors.begin(), detectors.end());
  detectors.erase(std::unique(detectors.begin(), detectors.end()), detectors.end());
  return detectors;
}

RoomWatch::RoomWatch(const ros::NodeHandle& nh) : nh_(nh), thread_([this] { work(); }) {}

RoomWatch::~RoomWatch()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  stopped_.notify_all();
  thread_.join();
}

Room RoomWatch::room() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return room_;
}

void RoomWatch::work()
{
  std::unique_lock<std::mutex> lock(mutex_);
  while (!stop_)
  {
    Room room = room_;
    lock.unlock();
    std::vector<std::string> topics;
    room.asked = true;
    room.master = findTopics(topics);
    if (room.master)
    {
      room.detectors = detectorsOf(topics, nh_.getNamespace());
      readSetup(room);
    }
    lock.lock();
    room_ = std::move(room);
    stopped_.wait_for(lock, kPeriod, [this] { return stop_; });
  }
}

bool RoomWatch::findTopics(std::vector<std::string>& topics) const
{
  XmlRpc::XmlRpcValue arguments, result, payload;
  arguments[0] = ros::this_node::getName();
  arguments[1] = std::string();
  // Not ros::master::getTopics(), which waits for a master that is gone.
  if (!ros::master::execute("getPublishedTopics", arguments, result, payload, false))
  {
    return false;
  }
  for (int i = 0; i < payload.size(); ++i)
  {
    if (std::string(payload[i][1]) == "sensor_msgs/Image")
    {
      topics.push_back(payload[i][0]);
    }
  }
  return true;
}

void RoomWatch::readSetup(Room& room)
{
  std::string path;
  for (const char* parameter : kSetupParameters)
  {
    if (nh_.getParam(parameter, path) && !path.empty())
    {
      break;
    }
  }
  if (path.empty())
  {
    path_.clear();
    room.setup.reset();
    room.setup_fault = "no node of the treatment room runs here (none has a parameter setup_file)";
    return;
  }
  boost::system::error_code error;
  const long modified = static_cast<long>(boost::filesystem::last_write_time(path, error));
  if (path == path_ && modified == modified_)
  {
    return;
  }
  path_ = path;
  modified_ = modified;
  room.setup.reset();
  room.setup_fault.clear();
  try
  {
    room.setup = std::make_shared<const TreatmentSetup>(loadTreatmentSetup(path));
    if (!nh_.getParam("registration/data_folder", room.data_folder) || room.data_folder.empty())
    {
      room.data_folder = usualDataFolder(*room.setup, path);
    }
  }
  catch (const std::exception& fault)
  {
    room.setup_fault = fault.what();
  }
}
}  // namespace xray_tracking
