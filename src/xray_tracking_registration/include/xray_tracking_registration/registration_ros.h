#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
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
#include "xray_tracking_registration/sequence_registration.h"

namespace xray_tracking
{
/// 2D-3D registration as a node: registers the exposures that it is asked about. Topics, services, action and
/// parameters: README.md.
///
/// A callback queue of its own with threads of its own: nothing here ever holds up a manager's other nodelets. One
/// request is worked on at a time, a service's in the thread that it came in, an action's in one for it; others are
/// told at once that it is busy. Parameters that it cannot work with are reported in the log, in diagnostics and to
/// whoever asks; it then stays idle.
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

  void start();
  void subscribe();
  /// @param handle called with every message
  template <typename Message>
  void subscribeTo(const std::string& topic, std::function<void(const boost::shared_ptr<Message const>&)> handle);
  void takeImage(std::size_t detector, const sensor_msgs::ImageConstPtr& image);
  void takeCameraInfo(std::size_t detector, const sensor_msgs::CameraInfoConstPtr& camera_info);
  void warnOfDropped(const std::string& why) const;
  /// Loads a CT, or the phantom where the path is empty, and makes it the one in use. @return why it could not; empty
  /// if it could
  std::string load(const std::string& ct_path);
  std::shared_ptr<const Registration> makeRegistration(const std::string& ct_path) const;

  /// Takes the place of the one request; @return false if there is one already
  bool claim();
  /// Works on the request of who has claimed it, publishes what came of it, and makes room for the next one.
  /// @param goal whom to tell of the progress; null: nobody
  RefinementResult serve(const RefinementRequest& request, GoalHandle* goal, const ros::SteadyTime& arrival);
  /// @param stamp_ns in: of the request; out: of the exposure that it means, if that is found
  RefinementResult refine(const RefinementRequest& message, const Progress& progress, std::int64_t& stamp_ns);
  void publishRefined(std::int64_t stamp_ns, const RefinementResult& result, double cpu_seconds,
                      const ros::SteadyTime& arrival);
  /// The exposure that a request means, see ExposureStore::find; waits for what of it is still on its way.
  /// @return why there is none; empty if there is
  std::string findExposure(std::int64_t& stamp_ns, StoredExposure& exposure);
  /// With all but the start.
  RegistrationRequest requestFor(const StoredExposure& exposure, Search search, const Progress& progress) const;
  RefinementResult busyResult() const;

  bool refinePoseCb(xray_tracking_msgs::RefinePose::Request& request,
                    xray_tracking_msgs::RefinePose::Response& response);
  bool loadVolumeCb(xray_tracking_msgs::LoadVolume::Request& request,
                    xray_tracking_msgs::LoadVolume::Response& response);
  void goalCb(GoalHandle goal);
  void cancelCb(GoalHandle goal);
  void workOnGoals();
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  RegistrationParameters parameters_;
  TreatmentSetup setup_;
  std::string configuration_fault_;  ///< empty if the node works

  /// Of the callbacks of a detector's images, one at a time.
  struct Intake
  {
    DetectorPixels pixels;
    std::size_t run = 0;  ///< that `pixels` is of
  };
  std::vector<Intake> intakes_;

  // Of who works on a request alone.
  std::optional<SequenceRegistration> sequence_;
  std::size_t run_ = 0;                 ///< that it is of
  std::deque<std::int64_t> published_;  ///< stamps of the last exposures on refined_pose

  std::atomic<bool> stop_{ false };
  std::atomic<bool> cancel_{ false };
  std::mutex mutex_;  ///< guards all from here to last_result_
  std::condition_variable wake_;
  bool busy_ = false;               ///< a request is being worked on
  std::optional<GoalHandle> goal_;  ///< the action's, if it is one
  ros::SteadyTime goal_arrival_;
  std::optional<ExposureStore> store_;
  std::shared_ptr<const Registration> registration_;
  std::string volume_state_ = "the volume is still being loaded";
  bool loading_ = true;
  std::size_t exposures_ = 0;  ///< published
  std::size_t refined_ = 0;    ///< with success
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
