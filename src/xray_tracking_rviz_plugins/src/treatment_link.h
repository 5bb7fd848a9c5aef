#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <actionlib/client/simple_action_client.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <xray_tracking_msgs/LoadVolume.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinePoseAction.h>
#include <xray_tracking_msgs/RefinedPose.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "gate_light.h"
#include "recent_values.h"
#include "xray_tracking_conversions/service_caller.h"

namespace xray_tracking
{
/// What a person asks of the graph.
enum class Command
{
  HOLD,    ///< or release
  TRAIN,   ///< every tracker learns its template anew; the references stay
  REFINE,  ///< the latest exposure is registered, and motion estimation is asked to have the next one registered
  RESET,   ///< trackers forget their templates, motion estimation starts over at the initial pose
  LOAD_CT
};
constexpr std::size_t kCommands = 5;

struct CommandState
{
  bool offered = false;  ///< all that it needs is there
  bool busy = false;
  bool failed = false;
  std::string text;  ///< what is missing, or how far it is, or what came of it; may be empty
};

/// Of one tracker, as its last message says.
struct TrackerView
{
  std::string detector;
  std::uint8_t state = xray_tracking_msgs::TrackedRegion::UNTRAINED;
  std::string fault;
  double correlation = 0.0;
  std::int64_t arrival = 0;  ///< monotonic clock [ns]; 0 if nothing came so far
};

/// Out of what motion estimation publishes, for a chart each.
enum class Quantity
{
  DISPLACEMENT,  ///< [mm]
  ROTATION,      ///< [degrees]
  SIGMA,         ///< of the displacement in its worst direction [mm]
  DISAGREEMENT,  ///< [px]
  SIMILARITY,
  LATENCY  ///< [ms]
};
constexpr std::size_t kQuantities = 6;

/// Everything at one time.
struct TreatmentView
{
  std::optional<HeardGate> gate;
  GateView gate_view;
  std::optional<xray_tracking_msgs::PatientMotion> motion;
  std::optional<xray_tracking_msgs::RefinedPose> refined;
  std::int64_t motion_arrival = 0, refined_arrival = 0;  ///< monotonic clock [ns]
  bool registration = false;                             ///< the node is there
  double rate = 0.0;                                     ///< exposures a second, over the last five
  std::vector<TrackerView> trackers;
  double max_displacement = 3.0, max_rotation = 3.0, max_sigma = 1.5;  ///< the gate's tolerances [mm, degrees, mm]
  std::array<CommandState, kCommands> commands;
  std::string frozen_clock;  ///< what is wrong with time; empty if nothing is
};

/// Root of the largest eigenvalue; NaN of what is none. @param covariance row-major [m^2] @return [mm]
double worstSigma(const boost::array<double, 9>& covariance);

/// All that a treatment panel has to do with ROS, in threads of its own; no method waits for another node.
class TreatmentLink
{
public:
  using Charts = std::array<RecentValues<double>, kQuantities>;
  using Lights = RecentValues<GateLight>;

  explicit TreatmentLink(const ros::NodeHandle& nh);
  ~TreatmentLink();

  TreatmentView view() const;
  /// Of the last minute.
  Charts charts() const;
  Lights lights() const;
  static std::int64_t now();  ///< monotonic clock [ns]

  /// To be called some times a second by who shows all this, from the thread that takes the operator's input: says by
  /// the heartbeat that the operator can hold the beam. Not while a hold that was asked for has not been confirmed:
  /// motion estimation then holds for the silence.
  void beat();

  void hold(bool on);
  void train();
  void refine();
  void cancelRefinement();
  void reset();
  void loadCt(const std::string& path);

private:
  using Trigger = std_srvs::Trigger;
  using Client = actionlib::SimpleActionClient<xray_tracking_msgs::RefinePoseAction>;

  struct Tracker
  {
    TrackerView view;
    ros::Subscriber subscriber;
    std::unique_ptr<ServiceCaller<Trigger>> retrain, reset;
  };

  void gateCb(const xray_tracking_msgs::BeamGate::ConstPtr& message);
  void motionCb(const xray_tracking_msgs::PatientMotion::ConstPtr& message);
  void refinedCb(const xray_tracking_msgs::RefinedPose::ConstPtr& message);
  void trackedCb(const xray_tracking_msgs::TrackedRegion::ConstPtr& message, Tracker& tracker);
  void refineDone(const actionlib::SimpleClientGoalState& state,
                  const xray_tracking_msgs::RefinePoseResultConstPtr& result);
  void sendGoal();
  /// None so far, or what stays.
  Client* refiner() const
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return refiner_.get();
  }

  /// Asks the master what there is, again and again.
  void watch();
  void watchOnce();
  void addTracker(const std::string& detector);

  CommandState& command(Command which) { return commands_[static_cast<std::size_t>(which)]; }
  void begin(Command which, const std::string& text);
  void end(Command which, bool success, const std::string& text);
  /// Of every tracker; the last answer ends it.
  void trackerAnswered(Command which, const std::string& detector, const std::optional<Trigger::Response>& response,
                       const std::string& why);
  void askTrackers(Command which);

  ros::NodeHandle nh_;
  ros::CallbackQueue queue_;
  mutable std::mutex mutex_;  ///< of all that follows, but for what is said
  std::optional<HeardGate> gate_;
  std::optional<xray_tracking_msgs::PatientMotion> motion_;
  std::optional<xray_tracking_msgs::RefinedPose> refined_;
  std::optional<geometry_msgs::Pose> pose_;
  std::int64_t motion_arrival_ = 0, refined_arrival_ = 0;
  RecentValues<bool> exposures_;  ///< arrivals
  Charts charts_;
  Lights lights_;
  std::map<std::string, std::unique_ptr<Tracker>> trackers_;
  std::array<CommandState, kCommands> commands_;
  double max_displacement_ = 3.0, max_rotation_ = 3.0, max_sigma_ = 1.5;
  bool registration_ = false;
  std::optional<bool> hold_asked_;  ///< what was asked last and has not been confirmed by the gate
  std::int64_t hold_tried_ = 0;     ///< monotonic clock [ns]
  int waiting_for_ = 0;             ///< answers of trackers
  std::string tracker_faults_;
  std::int64_t refine_began_ = 0;
  bool send_again_ = false;

  ros::Subscriber gate_subscriber_, motion_subscriber_, refined_subscriber_, pose_subscriber_;
  ros::Publisher heartbeat_;
  std::unique_ptr<ServiceCaller<std_srvs::SetBool>> hold_;
  std::unique_ptr<ServiceCaller<Trigger>> restart_, refine_next_;
  std::unique_ptr<ServiceCaller<xray_tracking_msgs::LoadVolume>> load_volume_;
  std::unique_ptr<Client> refiner_;  ///< made by the watcher once there is time: it would wait for that
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  bool stop_ = false;
  std::condition_variable stopping_;
  std::thread watcher_;
};
}  // namespace xray_tracking
