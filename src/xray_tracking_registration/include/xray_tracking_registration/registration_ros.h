#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <actionlib/server/action_server.h>
#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <xray_tracking_msgs/LoadVolume.h>
#include <xray_tracking_msgs/RefinePose.h>
#include <xray_tracking_msgs/RefinePoseAction.h>
#include <xray_tracking_msgs/RefinedPose.h>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_registration/exposure_store.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/registration_parameters.h"
#include "xray_tracking_registration/usable_pixels.h"

namespace xray_tracking
{
/// 2D-3D registration as a node: refines poses on request, or every exposure by itself if the method says so. Topics,
/// services, action and parameters: README.md.
///
/// A callback queue of its own with threads of its own: nothing here ever holds up a manager's other nodelets. One
/// thread registers; requests are told at once if it is busy with another one. Parameters that it cannot work with are
/// reported in the log, in diagnostics and to whoever asks; it then stays idle.
class RegistrationRos
{
public:
  RegistrationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~RegistrationRos();

private:
  using RefinementRequest = xray_tracking_msgs::RefinementRequest;
  using RefinementResult = xray_tracking_msgs::RefinementResult;
  using ActionServer = actionlib::ActionServer<xray_tracking_msgs::RefinePoseAction>;
  using GoalHandle = ActionServer::GoalHandle;
  using Progress = std::function<bool(const RegistrationProgress&)>;

  /// The one request being worked on.
  struct Job
  {
    RefinementRequest request;
    std::function<void(const RefinementResult&)> answer;
    std::optional<GoalHandle> goal;
    ros::SteadyTime arrival = ros::SteadyTime::now();
    bool running = false;
  };

  struct BelievedPose
  {
    RigidTransform room_from_patient;
    ros::Time stamp;
  };

  void start();
  void subscribe();
  /// @param store called with every message while the mutex is held
  template <typename Message>
  void subscribeTo(const std::string& topic, std::function<void(const boost::shared_ptr<Message const>&)> store);
  /// Loads a CT, or the phantom where the path is empty, and makes it the one in use. @return why it could not; empty
  /// if it could
  std::string load(const std::string& ct_path);
  std::shared_ptr<const Registration> makeRegistration(const std::string& ct_path) const;

  void work();
  void answerJob();
  void answerExposure(const ExposureStore::Due& due);
  RefinementResult refineRequest(const RefinementRequest& message, const Progress& progress);
  RefinementResult refineExposure(const ExposureStore::Due& due);
  void publishRefined(const ros::Time& stamp, const RefinementResult& result, double cpu_seconds,
                      const ros::SteadyTime& arrival);
  /// Forgets what an earlier run has left, if time has jumped back. With the mutex held.
  void noteRestart();
  /// The exposure that a request means; waits for what of it is still on its way.
  /// @return why there is none; empty if there is
  std::string findExposure(const ros::Time& stamp, StoredExposure& exposure);
  /// The registration in use; null if there is none.
  std::shared_ptr<const Registration> currentRegistration();
  /// With all but the start.
  /// @param usable of the detectors' kept exposures, or one of its own for images that a request brings along
  RegistrationRequest requestFor(const StoredExposure& exposure, Search search, UsablePixels& usable,
                                 const Progress& progress) const;
  /// @param stamp of the kept exposure; nothing for images that a request brings along
  /// @param unverified who asks has nothing that confirms the start
  RefinementResult run(const Registration& registration, RegistrationRequest request,
                       const std::optional<ros::Time>& stamp, bool unverified);

  /// Takes the place of the one request; @return false if there is one already
  bool claim(Job job);
  RefinementResult busyResult() const;
  bool refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                    xray_tracking_msgs::RefinePose::Response& response);
  bool loadVolumeCb(xray_tracking_msgs::LoadVolume::Request& request,
                    xray_tracking_msgs::LoadVolume::Response& response);
  void goalCb(GoalHandle goal);
  void cancelCb(GoalHandle goal);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  RegistrationParameters parameters_;
  TreatmentSetup setup_;
  std::string configuration_fault_;  ///< empty if the node works

  // Of the registering thread alone.
  RigidTransform accepted_pose_ = RigidTransform::Identity();  ///< room_from_patient of the last exposure
  RigidTransform target_from_rest_ = RigidTransform::Identity();
  std::optional<BelievedPose> believed_pose_;  ///< of a kept exposure, the last one that was asked about
  UsablePixels usable_pixels_;
  ros::Time last_refined_;  ///< exposure of the last refined_pose

  std::atomic<bool> stop_{ false };
  std::atomic<bool> cancel_{ false };
  std::mutex mutex_;  ///< guards all from here to last_result_
  std::condition_variable wake_;
  std::optional<Job> job_;
  std::optional<ExposureStore> store_;
  std::shared_ptr<const Registration> registration_;
  std::string volume_state_ = "the volume is still being loaded";
  bool loading_ = true;
  bool volume_is_new_ = false;  ///< what was found with the one before does not hold
  std::size_t exposures_ = 0;   ///< answered
  std::size_t refined_ = 0;     ///< with success
  std::optional<RefinementResult> last_result_;

  tf2_ros::Buffer tf_buffer_;
  tf2_ros::TransformListener tf_listener_;
  ros::Publisher refined_pose_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  std::unique_ptr<ActionServer> action_server_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  std::thread loader_;
  std::thread worker_;
};
}  // namespace xray_tracking
