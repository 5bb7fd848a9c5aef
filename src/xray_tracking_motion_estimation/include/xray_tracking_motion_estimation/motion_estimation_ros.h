#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/Header.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>

#include <xray_tracking_msgs/RefinePose.h>
#include <xray_tracking_msgs/TrackedRegion.h>
#include <xray_tracking_msgs/TrainRegion.h>

#include "xray_tracking_conversions/restart_file.h"
#include "xray_tracking_conversions/service_caller.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_motion_estimation/alignment_server.h"
#include "xray_tracking_motion_estimation/beam_gate_publisher.h"
#include "xray_tracking_motion_estimation/exposure_assembler.h"
#include "xray_tracking_motion_estimation/geometry_watch.h"
#include "xray_tracking_motion_estimation/motion_estimation_parameters.h"
#include "xray_tracking_motion_estimation/motion_memory.h"
#include "xray_tracking_motion_estimation/motion_monitor.h"
#include "xray_tracking_motion_estimation/motion_report.h"

namespace xray_tracking
{
/// The patient's pose from the regions tracked in two or more detectors and from registrations: the only one that
/// publishes tf treatment_room -> patient. Translates between ROS and MotionMonitor, which decides. Topics and
/// parameters: README.md. All callbacks must come from one thread; none blocks.
///
/// Parameters that it cannot work with are reported in the log and in diagnostics; it then stays idle, its
/// beam gate closed.
class MotionEstimationRos
{
public:
  MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~MotionEstimationRos();

private:
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;
  using RefinePose = xray_tracking_msgs::RefinePose;
  using TrainRegion = xray_tracking_msgs::TrainRegion;

  struct View
  {
    std::string name;
    ros::Subscriber camera_info_subscriber;
    ros::Subscriber tracked_region_subscriber;
    ros::SteadyTime last_arrival;
    bool silent = false;  ///< not waited for while two others are there
    std::unique_ptr<ServiceCaller<TrainRegion>> trainer;
  };

  void start();
  void subscribe(View& view, std::size_t index);
  void trackedRegionCb(const TrackedRegion::ConstPtr& message, std::size_t view);
  bool refineCb(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);
  bool restartCb(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);
  bool holdBeamCb(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response);
  void operatorPresentCb(const std_msgs::Header::ConstPtr& message);
  void watchdogCb(const ros::SteadyTimerEvent& event);
  void deadlineCb(const ros::SteadyTimerEvent& event);
  void reportCb(const ros::SteadyTimerEvent& event);

  /// What a process before this one left behind, if there was one.
  void readRestartFile();
  /// What poses counted from is not known any more: the patient may be anywhere.
  void cannotGoOn(const std::string& why);
  /// With the geometry. @param stamp of the first exposure [ns]
  void takeUp(std::int64_t stamp);
  /// Keeps what is known for a process after this one. @param wait until it is on the disk, if that is not slow
  /// @return whether it is, if that was waited for; else whether it is on its way
  bool keep(bool wait);

  /// Gives the geometry to the monitor, or sees whether it is still the one that it has. @return what is wrong; empty
  /// if nothing is
  /// @param stamp of the exposure [ns]
  std::string checkGeometry(std::int64_t stamp);
  void setSilent(std::size_t view, bool silent);
  /// Does what the monitor has decided.
  void settle();
  void publish(const MotionDecision& decision);
  void publishPrediction();
  void publishGate();
  void ask(const RefinementRequest& request);
  void train(const RegionProposal& proposal);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);
  std::vector<ViewReport> viewReports() const;
  AssemblyCounts assemblyCounts() const;

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  std::string configuration_fault_;  ///< empty if the node works
  MotionEstimationParameters parameters_;
  TreatmentSetup setup_;
  std::shared_future<TargetShape> shape_;  ///< may have to be read from a CT
  std::vector<View> views_;
  std::optional<ExposureAssembler<TrackedRegion::ConstPtr>> assembler_;
  bool has_geometry_ = false;  ///< the monitor
  std::optional<MotionMonitor> monitor_;
  MotionReport report_;
  BeamGate idle_gate_;  ///< of a node that cannot work

  std::optional<RestartFile> restart_file_;  ///< none: nothing is kept
  std::optional<RunMemory> before_;  ///< what was left behind, with a motion, until that is taken up or cannot be
  std::future<bool> keeping_;
  // What was kept last of what people say.
  std::string kept_hold_;
  bool kept_operator_ = false;

  ros::Time started_;      ///< this node; zero until a simulated clock has come
  ros::Time first_heard_;  ///< earliest exposure since the start; zero before
  ros::Time latest_;       ///< exposure that was decided last
  ros::SteadyTime first_arrival_;

  tf2_ros::Buffer tf_buffer_;
  std::optional<GeometryWatch> geometry_;
  tf2_ros::TransformListener tf_listener_;
  tf2_ros::TransformBroadcaster tf_broadcaster_;
  ros::Publisher pose_publisher_;
  ros::Publisher motion_publisher_;
  ros::Publisher prediction_publisher_;
  BeamGatePublisher gate_publisher_;
  ros::ServiceServer refine_server_;
  ros::ServiceServer restart_server_;
  ros::ServiceServer hold_beam_server_;
  ros::Subscriber operator_subscriber_;
  std::unique_ptr<AlignmentServer> alignment_server_;
  std::uint64_t asked_ = 0;                   ///< the request that the registration is at
  std::vector<std::string> compared_;         ///< the detectors that it is to compare, in the setup file's order
  std::optional<RefinementRequest> waiting_;  ///< the one that it is asked next
  std::unique_ptr<ServiceCaller<RefinePose>> registration_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer watchdog_;
  ros::SteadyTimer deadline_timer_;
  ros::SteadyTimer report_timer_;
};
}  // namespace xray_tracking
