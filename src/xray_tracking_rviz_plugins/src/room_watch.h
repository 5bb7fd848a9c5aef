#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <ros/node_handle.h>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// What the master knows of the treatment room.
struct Room
{
  bool asked = false;                           ///< whether the master has been asked at all
  bool master = false;                          ///< whether it answered the last time
  std::vector<std::string> detectors;           ///< see detectorsOf()
  std::shared_ptr<const TreatmentSetup> setup;  ///< null if there is none
  std::string data_folder;                      ///< where a CT may come from that the setup does not name
  std::string setup_fault;                      ///< why there is none, for people
};

/// The detectors in a list of topics, which are those with an `image_raw`: sorted, and without the namespace where they
/// are in it.
/// @param topics resolved names; @param name_space resolved, "/" for none
std::vector<std::string> detectorsOf(const std::vector<std::string>& topics, const std::string& name_space);

/// Asks the master once a second, in a thread of its own, which detectors there are, and reads the setup file that
/// the treatment room's nodes were given, again when it changes. All methods return at once.
class RoomWatch
{
public:
  explicit RoomWatch(const ros::NodeHandle& nh);
  /// Waits for what is under way with the master, which answers or refuses.
  ~RoomWatch();

  RoomWatch(const RoomWatch&) = delete;
  RoomWatch& operator=(const RoomWatch&) = delete;

  Room room() const;

private:
  void work();
  /// @return whether the master answered
  bool findTopics(std::vector<std::string>& topics) const;
  void readSetup(Room& room);

  ros::NodeHandle nh_;
  std::string path_;  ///< of the setup that was read last
  long modified_ = 0;
  mutable std::mutex mutex_;
  std::condition_variable stopped_;
  bool stop_ = false;
  Room room_;
  std::thread thread_;  ///< last: it uses all the others
};
}  // namespace xray_tracking
