#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>

#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_motion_estimation/camera_info_watch.h"
#include "xray_tracking_motion_estimation/exposure_assembler.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/pose_history.h"

namespace xray_tracking
{
/// The 3D motion of the patient from the regions tracked in two or more detectors; the only one that publishes tf
/// treatment_room -> patient. Topics and parameters: README.md. All callbacks must come from one thread.
///
/// Parameters that it cannot work with are reported in the log and in diagnostics; it then stays idle.
class MotionEstimationRos
{
public:
  MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~MotionEstimationRos();

private:
  using PatientMotion = xray_tracking_msgs::PatientMotion;
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;

  struct View
  {
    std::string name;
    ros::Subscriber camera_info_subscriber;
    ros::Subscriber tracked_region_subscriber;
    CameraInfoWatch camera_info;
    RigidTransform room_from_optical;  ///< the one that the estimator uses, if there is one
    std::optional<std::pair<ros::Time, RigidTransform>> reference;  ///< what the template in use was trained on
    ros::SteadyTime last_arrival;
    bool silent = false;
    std::string logged_fault;  ///< of camera_info
  };

  void start();
  void trackedRegionCb(const TrackedRegion::ConstPtr& message, std::size_t view);
  void timerCb(const ros::SteadyTimerEvent& event);

  /// The state of the last complete exposure before anything is estimated; OK if it can be.
  PatientMotion motionFromStates() const;
  /// Makes the estimator, or sees whether the geometry is still the one that it was made with; never estimates with
  /// another. @return what is wrong; empty if nothing is
  std::string checkGeometry();
  /// @return which reference exposure's pose is not known; empty if all are
  std::string findReferences();
  std::optional<MotionEstimate> estimate(PatientMotion& motion);
  void publishPose(const MotionEstimate& estimate, const ros::Time& stamp);
  void report(const PatientMotion& motion);
  void logMotion();
  void forget();
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  std::string configuration_fault_;  ///< empty if the node works
  double view_timeout_ = 0.0;        ///< [s]
  MotionEstimationOptions options_;
  TreatmentSetup setup_;

  std::vector<View> views_;
  std::optional<ExposureAssembler<TrackedRegion::ConstPtr>> assembler_;
  std::optional<MotionEstimator> estimator_;
  PoseHistory history_;
  std::vector<ViewMeasurement> measurements_;

  std::optional<PatientMotion> last_motion_;
  std::string logged_reason_;  ///< of the last motion that was logged
  ros::SteadyTime first_arrival_;
  ros::SteadyTime last_exposure_;  ///< when the last one was complete
  std::size_t exposures_ = 0;
  std::size_t poses_ = 0;
  std::size_t exposures_at_last_diagnosis_ = 0;
  std::size_t drops_at_last_warning_ = 0;
  ros::SteadyTime last_diagnosis_;

  tf2_ros::Buffer tf_buffer_;
  tf2_ros::TransformListener tf_listener_;
  tf2_ros::TransformBroadcaster tf_broadcaster_;
  ros::Publisher pose_publisher_;
  ros::Publisher motion_publisher_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
};
}  // namespace xray_tracking
