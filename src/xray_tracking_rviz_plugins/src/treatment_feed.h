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

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/ros.h>

#include "recent_values.h"
#include "treatment_view.h"

namespace xray_tracking
{
/// Root of the largest eigenvalue; NaN of what is none. @param covariance row-major [m^2] @return [mm]
double worstSigma(const boost::array<double, 9>& covariance);

/// What the graph says of a treatment, as it comes, and what of it charts show. To be used from any thread.
class TreatmentFeed
{
public:
  using Charts = std::array<RecentValues<double>, kQuantities>;
  using Lights = RecentValues<GateLight>;
  using GateSaid = std::function<void(const xray_tracking_msgs::BeamGate& gate)>;

  /// @param nh whose callback queue takes the messages; @param gate_said called there with every message of the gate
  TreatmentFeed(const ros::NodeHandle& nh, GateSaid gate_said);

  /// Fills in all but the commands and what the registration offers.
  void show(TreatmentView& view) const;
  /// Of the last minute.
  Charts charts() const;
  Lights lights() const;
  std::optional<geometry_msgs::Pose> pose() const;  ///< the last one that is known

  /// To be called some times a second: the gate's light is noted where it changes.
  void noteLight();
  /// Asks the master for trackers and the gate's tolerances; for one thread. @return detectors whose trackers are new
  std::vector<std::string> look();

private:
  struct Tracker
  {
    TrackerView view;
    ros::Subscriber subscriber;
  };

  void gateCb(const ros::MessageEvent<xray_tracking_msgs::BeamGate const>& event);
  void motionCb(const xray_tracking_msgs::PatientMotion::ConstPtr& message);
  void refinedCb(const xray_tracking_msgs::RefinedPose::ConstPtr& message);
  void trackedCb(const xray_tracking_msgs::TrackedRegion::ConstPtr& message, Tracker& tracker);
  /// Of the latest exposure, once its gate and its motion are both there; with the mutex locked.
  void noteRotation();
  void addTracker(const std::string& detector);
  GateView gateNow() const;

  ros::NodeHandle nh_;
  GateSaid gate_said_;
  mutable std::mutex mutex_;  ///< of all that follows, but for the subscribers
  std::optional<HeardGate> gate_;
  std::map<std::string, std::int64_t> gates_from_;  ///< when each node's last gate came, monotonic clock [ns]
  std::optional<xray_tracking_msgs::PatientMotion> motion_;
  std::optional<xray_tracking_msgs::RefinedPose> refined_;
  std::optional<geometry_msgs::Pose> pose_;
  std::int64_t motion_arrival_ = 0, refined_arrival_ = 0;
  ros::Time rotation_of_;         ///< stamp of the exposure whose rotation was noted last
  RecentValues<bool> exposures_;  ///< arrivals
  Charts charts_;
  Lights lights_;
  std::map<std::string, std::unique_ptr<Tracker>> trackers_;
  double max_displacement_ = 3.0, max_rotation_ = 3.0, max_sigma_ = 1.5, max_tracked_sigma_ = 1.5;
  ros::Subscriber gate_subscriber_, motion_subscriber_, refined_subscriber_, pose_subscriber_;
};
}  // namespace xray_tracking
