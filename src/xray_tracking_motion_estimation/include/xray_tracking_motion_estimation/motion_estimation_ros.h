#pragma once

#include <cstdint>
#include <future>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>
#include <boost/circular_buffer.hpp>

#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_motion_estimation/beam_gate_ros.h"
#include "xray_tracking_motion_estimation/camera_info_watch.h"
#include "xray_tracking_motion_estimation/consistency_monitor.h"
#include "xray_tracking_motion_estimation/exposure_assembler.h"
#include "xray_tracking_motion_estimation/motion_estimation_parameters.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/pose_history.h"
#include "xray_tracking_motion_estimation/pose_predictor.h"
#include "xray_tracking_motion_estimation/refinement_client.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"

namespace xray_tracking
{
/// The 3D motion of the patient from the regions tracked in two or more detectors; the only one that publishes tf
/// treatment_room -> patient. Topics and parameters: README.md. All callbacks must come from one thread; none blocks.
///
/// Parameters that it cannot work with are reported in the log and in diagnostics; it then stays idle, its
/// beam gate closed.
class MotionEstimationRos
{
public:
  MotionEstimationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~MotionEstimationRos();

private:
  using PatientMotion = xray_tracking_msgs::PatientMotion;
  using TrackedRegion = xray_tracking_msgs::TrackedRegion;

  /// Why a view takes no part in an exposure; OK if it does.
  struct Doubt
  {
    std::uint8_t state = PatientMotion::OK;
    std::string reason;
  };

  /// What a view's tracks are relative to.
  struct Reference
  {
    ros::Time template_stamp;          ///< exposure that the template was trained on
    RigidTransform room_from_patient;  ///< at that exposure, or at the anchor's
    std::optional<Track> anchor = {};  ///< how the template was tracked in an exposure whose pose was refined
  };

  struct View
  {
    std::string name;
    ros::Subscriber camera_info_subscriber;
    ros::Subscriber tracked_region_subscriber;
    CameraInfoWatch camera_info;
    RigidTransform room_from_optical;    ///< the one that the estimator uses, if there is one
    std::optional<Reference> reference;  ///< of the template in use
    Doubt doubt;                         ///< of the last exposure
    std::string logged_doubt;            ///< while the others made a pose
    ros::SteadyTime last_arrival;
    bool silent = false;       ///< not waited for while two others are there
    std::string logged_fault;  ///< of camera_info
  };

  void start();
  void trackedRegionCb(const TrackedRegion::ConstPtr& message, std::size_t view);
  void timerCb(const ros::SteadyTimerEvent& event);

  // Of the last complete exposure, in exposure_estimation.cpp. What they say to `motion` is why there is no pose.
  std::optional<MotionEstimate> estimate(PatientMotion& motion);
  /// @param region null if the view was not waited for
  Doubt doubtOfState(const View& view, const TrackedRegion* region) const;
  /// @return false, and the worst doubt in `motion`, if fewer than two views take part
  bool enoughViews(PatientMotion& motion) const;
  /// Makes the estimator, or sees whether the geometry is still the one that it was made with; never estimates with
  /// another. @return what is wrong; empty if nothing is
  std::string checkGeometry();
  /// Doubts views whose reference exposure's pose is not known.
  void findReferences();
  /// Of the first templates' exposures: whether the patient was at the initial pose then.
  void judgeStart(const ros::Time& first, const ros::Time& last);
  /// How a view tracked an exposure, with what it may have moved by between the views. @param offset of its stamp [ns]
  Track trackOf(std::size_t view, const TrackedRegion& region, std::int64_t offset) const;
  ViewMeasurement measure(std::size_t view) const;
  void judgeConsistency(const MotionEstimate& estimate, PatientMotion& motion);

  void publishPose(const MotionEstimate& estimate, const ros::Time& stamp);
  void publishPrediction();
  void setSilent(std::size_t view, bool silent);
  void tellGate(const PatientMotion& motion, const std::optional<MotionEstimate>& estimate);
  Eigen::Vector3d displacement(const RigidTransform& room_from_patient) const;
  void forget();

  // Refinement by registration, in motion_refinement.cpp.
  void startRefinement();
  bool refineCb(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);
  void refinementCb(const ros::SteadyTimerEvent& event);
  /// Tells the policy of the last complete exposure.
  void considerRefinement(const PatientMotion& motion, const std::optional<MotionEstimate>& estimate);
  void accept(const Refinement& refinement);

  // For people, in motion_estimation_diagnostics.cpp.
  void report(const PatientMotion& motion);
  void logMotion();
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  std::string configuration_fault_;  ///< empty if the node works
  MotionEstimationParameters parameters_;
  TreatmentSetup setup_;
  std::shared_future<TargetShape> shape_;  ///< may have to be read from a CT

  std::vector<View> views_;
  std::optional<ExposureAssembler<TrackedRegion::ConstPtr>> assembler_;
  std::vector<ProjectionGeometry> geometries_;  ///< what the first estimator was made with; empty before
  RigidTransform reference_;                    ///< pose that motion is counted from: the setup's until it is refined
  Matrix6d reference_covariance_ = Matrix6d::Zero();  ///< of the target's centre and rotation
  std::optional<MotionEstimator> estimator_;
  std::string observability_;  ///< of the geometry, for people
  std::optional<ConsistencyMonitor> consistency_;
  std::optional<ConsistencyMonitor> rigid_consistency_;  ///< refuses nothing
  PoseHistory history_;
  /// The last pose that is known, measured or refined, and its stamp [ns].
  std::optional<std::pair<std::int64_t, RigidTransform>> last_pose_;
  std::vector<std::optional<ViewMeasurement>> measurements_;
  std::optional<BeamGateRos> gate_;
  ros::Time started_;                      ///< this node; zero until a simulated clock has come
  std::optional<ros::Time> first_heard_;   ///< earliest exposure since the start
  std::optional<ros::Time> first_unseen_;  ///< first exposure that gave a view no template while nothing was measured
  std::optional<PosePredictor> predictor_;
  std::optional<RefinementPolicy> refinement_;
  std::optional<RefinementClient> refinement_client_;
  /// The latest exposures' tracks, which a refinement anchors; one a view, null if it was not waited for.
  struct TrackedViews
  {
    std::int64_t stamp;
    std::vector<TrackedRegion::ConstPtr> regions;
    std::vector<std::int64_t> offsets;  ///< of the regions' stamps [ns]
  };
  boost::circular_buffer<TrackedViews> tracked_views_;

  std::optional<PatientMotion> last_motion_;
  std::string logged_reason_;  ///< of the last motion that was logged
  ros::SteadyTime first_arrival_;
  ros::SteadyTime last_exposure_;  ///< when the last one was complete
  std::size_t exposures_ = 0;
  std::size_t poses_ = 0;
  std::size_t differing_ = 0;  ///< exposures whose views differed
  std::size_t exposures_at_last_diagnosis_ = 0;
  std::size_t drops_at_last_warning_ = 0;
  ros::SteadyTime last_diagnosis_;

  tf2_ros::Buffer tf_buffer_;
  tf2_ros::TransformListener tf_listener_;
  tf2_ros::TransformBroadcaster tf_broadcaster_;
  ros::Publisher pose_publisher_;
  ros::Publisher motion_publisher_;
  ros::Publisher prediction_publisher_;
  ros::ServiceServer refine_server_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer refinement_timer_;
  ros::SteadyTimer timer_;
};
}  // namespace xray_tracking
