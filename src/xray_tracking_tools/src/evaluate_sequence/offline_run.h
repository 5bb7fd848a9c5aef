#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/view_tracker.h"
#include "xray_tracking_motion_estimation/motion_monitor.h"
#include "xray_tracking_registration/sequence_registration.h"
#include "xray_tracking_registration/usable_pixels.h"

namespace xray_tracking
{
/// One method's way through the exposures, without ROS: the trackers, the motion monitor and the registration that the
/// live graph has, with its default parameters. Nothing is ever late, so that the same exposures give the same poses to
/// the last bit.
class OfflineRun
{
public:
  /// @param registration null for a method that needs none
  /// @param refine_every the registration is asked for every so-manieth exposure, and when the gate wants to know;
  /// 1: for each
  /// @param paper as published: 600 single pixels, the predictors' steps alone, translations, eqs. (2) to (8); of
  /// method TRACKING
  /// @throws std::invalid_argument for a region or geometry that is of no use
  OfflineRun(const TreatmentSetup& setup, PoseMethod method, std::shared_ptr<const Registration> registration,
             int refine_every, bool paper);

  /// The next exposure. @param images of the setup's detectors, in their order
  MotionDecision add(std::int64_t stamp_ns, const std::vector<cv::Mat>& images);

  const BeamGate& gate() const { return monitor_.gate(); }
  /// The tracks of the last exposure, of the setup's detectors, in their order.
  const std::vector<TrackedView>& lastViews() const { return last_views_; }
  /// Processor time that the last exposure's registrations took [s].
  double registrationSeconds() const { return registration_seconds_; }
  const MotionMonitorOptions& options() const { return options_; }

private:
  struct View
  {
    std::unique_ptr<ViewTracker> tracker;
    DetectorPixels pixels;
    UsableImage image;  ///< of the current exposure
    std::optional<Training> training;
  };
  TrackedExposure track(std::int64_t stamp_ns, const std::vector<cv::Mat>& images);
  RefinementReply registered(const RefinementRequest& request);

  TreatmentSetup setup_;
  MotionMonitorOptions options_;
  MotionMonitor monitor_;
  std::vector<View> views_;
  std::vector<TrackedView> last_views_;
  double registration_seconds_ = 0.0;
  std::shared_ptr<const Registration> registration_;
  std::optional<SequenceRegistration> sequence_;
};
}  // namespace xray_tracking
