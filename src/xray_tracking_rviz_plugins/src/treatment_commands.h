#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <actionlib/client/simple_action_client.h>
#include <geometry_msgs/Pose.h>
#include <ros/ros.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <xray_tracking_msgs/LoadVolume.h>
#include <xray_tracking_msgs/RefinePoseAction.h>

#include "treatment_view.h"
#include "xray_tracking_conversions/service_caller.h"

namespace xray_tracking
{
/// What a person asks of the graph, and what becomes of it. No method but look() waits for another node. To be used
/// from any thread, but for what is said.
class TreatmentCommands
{
public:
  using LastPose = std::function<std::optional<geometry_msgs::Pose>()>;

  /// @param nh whose callback queue takes the answers; @param last_pose from which a refinement starts
  TreatmentCommands(const ros::NodeHandle& nh, LastPose last_pose);
  /// Whose threads call the queue have ended.
  ~TreatmentCommands();

  std::array<CommandState, kCommands> states() const;
  bool registrationIsThere() const;  ///< when it was looked for last

  void hold(bool on);
  void train();
  void refine();
  void cancelRefinement();
  void reset();
  void loadCt(const std::string& path);

  /// A tracker that takes part from here on; for the thread of look().
  void addTracker(const std::string& detector);
  /// Asks the master what is offered; for one thread.
  void look();
  /// Of every message of the gate: a hold or release is confirmed by it.
  void gateSaid(const xray_tracking_msgs::BeamGate& gate);
  /// To be called some times a second: a hold that was asked for, and not confirmed, is asked for again.
  /// @return false while there is one
  bool holdIsConfirmed();
  /// To be called some times a second: a refinement that found the registration at another request is asked for again.
  void refineAgain();

private:
  using Trigger = std_srvs::Trigger;
  using Client = actionlib::SimpleActionClient<xray_tracking_msgs::RefinePoseAction>;

  struct Tracker
  {
    std::unique_ptr<ServiceCaller<Trigger>> retrain, reset;
  };

  /// What trackers have yet to answer, and what went wrong so far.
  struct Round
  {
    int waiting_for = 0;
    std::string faults;
  };

  void refineDone(const actionlib::SimpleClientGoalState& state,
                  const xray_tracking_msgs::RefinePoseResultConstPtr& result);
  void sendGoal();
  /// None so far, or what stays.
  Client* refiner() const
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return refiner_.get();
  }

  /// Which of these services there are not, in words; empty if all are there.
  std::string missing(const std::vector<std::string>& services) const;
  /// What each command lacks, in words.
  std::array<std::string, kCommands> wants() const;

  CommandState& command(Command which) { return commands_[static_cast<std::size_t>(which)]; }
  /// Of the hold's service; with the mutex locked. @return false if an earlier call is still under way
  bool callHold(bool on);
  void holdAnswered(bool success, const std::string& text);
  void begin(Command which, const std::string& text);
  void end(Command which, bool success, const std::string& text);
  /// Of every tracker; the last answer ends it.
  void trackerAnswered(Command which, const std::string& detector, const std::optional<Trigger::Response>& response,
                       const std::string& why);
  void askTrackers(Command which);

  ros::NodeHandle nh_;
  LastPose last_pose_;
  mutable std::mutex mutex_;  ///< of all that follows
  std::map<std::string, Tracker> trackers_;
  std::array<CommandState, kCommands> commands_;
  bool registration_ = false;
  std::optional<bool> hold_asked_;  ///< what was asked last and has not been confirmed by the gate
  bool hold_called_ = false;        ///< what the last call of the service was for
  bool hold_answered_ = false;      ///< a call for what was asked last has succeeded
  std::int64_t hold_tried_ = 0;     ///< monotonic clock [ns]
  std::array<Round, kCommands> rounds_;
  std::int64_t refine_began_ = 0;
  bool send_again_ = false;
  std::unique_ptr<ServiceCaller<std_srvs::SetBool>> hold_;
  std::unique_ptr<ServiceCaller<Trigger>> restart_, refine_next_;
  std::unique_ptr<ServiceCaller<xray_tracking_msgs::LoadVolume>> load_volume_;
  std::unique_ptr<Client> refiner_;  ///< made once there is time: it would wait for that
};
}  // namespace xray_tracking
