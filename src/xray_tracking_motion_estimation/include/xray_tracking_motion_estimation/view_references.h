#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/pose_history.h"
#include "xray_tracking_motion_estimation/refinement_policy.h"
#include "xray_tracking_motion_estimation/tracked_view.h"

namespace xray_tracking
{
/// What a view's tracks are relative to.
struct ViewReference
{
  std::int64_t template_stamp = 0;   ///< of the exposure that the template was trained on [ns]
  cv::Rect region;                   ///< the template's [px]
  RigidTransform learnt_at;          ///< the pose at which it was learnt
  RigidTransform room_from_patient;  ///< what tracks count from: `learnt_at`, or the anchor's
  std::optional<Track> anchor;       ///< how the template was tracked there
  std::int64_t anchor_stamp = 0;     ///< the anchor's exposure [ns]
  bool registered = false;           ///< both poses are known from registrations, or were corrected by one
};

/// What the views' tracks are relative to: the pose of the exposure that a template was trained on, or of an exposure
/// that was registered while the template was tracked (its anchor).
class ViewReferences
{
public:
  explicit ViewReferences(std::size_t views);

  /// Whether no pose is known so far.
  bool empty() const { return history_.empty(); }
  void clear();

  /// The pose of an exposure, which templates may have been trained on.
  /// @param registered it will not be moved by what is found later
  void add(const TrackedExposure& exposure, const RigidTransform& room_from_patient, bool registered);
  /// The same for one stamp [ns]; not registered.
  void add(std::int64_t stamp, const RigidTransform& room_from_patient);

  /// Finds what the view's template is relative to. @return false if the pose of its exposure is not known
  bool find(std::size_t view, const TrackedView& tracked);

  /// After find(). @param track of the view, with all that it is uncertain by; @param stamp of its exposure [ns]
  ViewMeasurement measurement(std::size_t view, const Track& track, std::int64_t stamp) const;

  /// From here on the view's track counts from this exposure, at this pose: what it was wrong by until then is out of
  /// it. Nothing happens if the view has got a newer template meanwhile, or one that was learnt at a pose that is not
  /// known and is elsewhere now than the one before it would be: that follows something else.
  /// @param stamp of the exposure [ns]; @param expected regionAt() this pose
  void anchor(std::size_t view, const TrackedView& tracked, const Track& track, std::int64_t stamp,
              const RigidTransform& room_from_patient, const std::optional<cv::Rect>& expected);

  /// Moves all poses that were tracked, not registered, as a refinement does, once. If it was found without tracks,
  /// nothing connects them with it: they are not known any more.
  void carry(const Refinement& refinement, const Eigen::Vector3d& target_centre);

  /// When the view's latest template whose pose is known was learnt [ns]; nothing if there is none.
  std::optional<std::int64_t> templateStamp(std::size_t view) const;

  /// Where the template's region would be seen with the patient elsewhere: moved as the target's centre is.
  /// @return nothing if the view has had no template whose pose is known
  std::optional<cv::Rect> regionAt(std::size_t view, const ProjectionGeometry& geometry,
                                   const RigidTransform& room_from_patient, const Eigen::Vector3d& target_centre) const;

  /// One a view; nothing of one that has had no template whose pose is known.
  const std::vector<std::optional<ViewReference>>& references() const { return references_; }
  /// As another's were, one a view.
  void takeUp(const std::vector<std::optional<ViewReference>>& references) { references_ = references; }

private:
  PoseHistory history_;
  std::vector<std::optional<ViewReference>> references_;
};
}  // namespace xray_tracking
