#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <xray_tracking_msgs/LoadVolume.h>
#include <xray_tracking_msgs/RefinedPose.h>

#include "xray_tracking_conversions/restart_file.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_registration/exposure_intake.h"
#include "xray_tracking_registration/refinement_server.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/registration_parameters.h"
#include "xray_tracking_registration/render_server.h"
#include "xray_tracking_registration/sequence_registration.h"

namespace xray_tracking
{
/// 2D-3D registration as a node: registers the exposures that it is asked about. Topics, services, action and
/// parameters: README.md. ExposureIntake takes in the exposures, RefinementServer the requests; here are the CT and
/// what comes of a request.
///
/// A callback queue of its own with threads of its own: nothing here ever holds up a manager's other nodelets.
/// Parameters that it cannot work with are reported in the log, in diagnostics and to whoever asks; it then stays idle.
class RegistrationRos
{
public:
  RegistrationRos(const ros::NodeHandle& nh, const ros::NodeHandle& pnh);
  ~RegistrationRos();

private:
  using RefinementRequest = xray_tracking_msgs::RefinementRequest;
  using RefinementResult = xray_tracking_msgs::RefinementResult;
  using Progress = RefinementServer::Progress;

  void start();
  /// Null until the node listens for exposures.
  ExposureIntake* intake();
  /// Loads a CT, or the phantom where the path is empty, and makes it the one in use. @return why it could not; empty
  /// if it could
  std::string load(const std::string& ct_path);
  /// The same of the first one: the setup's, or what the node that this one takes the place of was told to load.
  std::string loadFirst();
  /// The same of a path that somebody asks for: below the data folder alone.
  std::string loadAsked(const std::string& ct_path);
  /// Says why there is none, where none is in use. @return that
  std::string notLoaded(const std::string& fault);
  BodyModel readBodies(const std::string& ct_path) const;
  std::shared_ptr<const Registration> makeRegistration(const std::string& ct_path) const;

  /// Works on a request and publishes what came of it.
  RefinementResult serve(const RefinementRequest& request, const Progress& progress, const ros::SteadyTime& arrival);
  /// @param stamp_ns in: of the request; out: of the exposure that it means, if that is found
  RefinementResult refine(const RefinementRequest& message, const Progress& progress, std::int64_t& stamp_ns);
  void publishRefined(std::int64_t stamp_ns, const RefinementResult& result, double cpu_seconds,
                      const ros::SteadyTime& arrival);
  /// With all but the start.
  RegistrationRequest requestFor(const StoredExposure& exposure, const RefinementRequest& message,
                                 const Progress& progress) const;

  /// The CT in use. @param why out: why there is none
  std::shared_ptr<const Registration> registration(std::string& why);

  bool loadVolumeCb(xray_tracking_msgs::LoadVolume::Request& request,
                    xray_tracking_msgs::LoadVolume::Response& response);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  ros::NodeHandle pnh_;
  RegistrationParameters parameters_;
  TreatmentSetup setup_;
  std::string configuration_fault_;  ///< empty if the node works
  /// None: nothing is kept. There is no file before somebody has asked for a CT.
  std::optional<RestartFile> restart_file_;

  // Of who works on a request alone.
  std::optional<SequenceRegistration> sequence_;
  std::size_t run_ = 0;                 ///< that it is of
  std::deque<std::int64_t> published_;  ///< stamps of the last exposures that were found and are on refined_pose

  std::mutex mutex_;                        ///< guards all from here to last_result_
  std::unique_ptr<ExposureIntake> intake_;  ///< made once; none before the CT is there
  std::shared_ptr<const Registration> registration_;
  std::string volume_state_ = "the volume is still being loaded";
  bool loading_ = true;
  std::size_t exposures_ = 0;  ///< published, of those that were found
  std::size_t refined_ = 0;    ///< with success
  std::optional<RefinementResult> last_result_;

  tf2_ros::Buffer tf_buffer_;
  tf2_ros::TransformListener tf_listener_;
  ros::Publisher refined_pose_publisher_;
  ros::Publisher volume_publisher_;
  ros::ServiceServer load_service_;
  std::unique_ptr<RefinementServer> server_;
  std::unique_ptr<RenderServer> render_server_;
  diagnostic_updater::Updater updater_;
  ros::SteadyTimer timer_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  std::thread loader_;
};
}  // namespace xray_tracking
