#include "xray_tracking_motion_estimation/view_references.h"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace xray_tracking
{
namespace
{
/// Templates refer to exposures of the last seconds; the reference in use is kept apart.
constexpr std::size_t kHistoryCapacity = 1000;

/// Of a reference that is forgotten but for where its region was: older than any.
constexpr std::int64_t kNoTemplate = std::numeric_limits<std::int64_t>::min();

/// Another region of the same exposure is another template.
bool isOf(const ViewReference& reference, const TrackedView& tracked)
{
  return reference.template_stamp == tracked.reference_stamp &&
         (!reference.anchor || reference.anchor->centre == tracked.track.centre);
}
}  // namespace

ViewReferences::ViewReferences(std::size_t views) : history_(kHistoryCapacity), references_(views) {}

void ViewReferences::clear()
{
  history_.clear();
  references_.assign(references_.size(), std::nullopt);
}

void ViewReferences::add(const TrackedExposure& exposure, const RigidTransform& room_from_patient, bool registered)
{
  history_.add({ exposure.stamp, room_from_patient, registered });
  for (const std::optional<TrackedView>& view : exposure.views)
  {
    // A template's reference is known by its own view's stamp.
    if (view && view->offset != 0)
    {
      history_.add({ exposure.stamp + view->offset, room_from_patient, registered });
    }
  }
}

void ViewReferences::add(std::int64_t stamp, const RigidTransform& room_from_patient)
{
  history_.add({ stamp, room_from_patient, false });
}

bool ViewReferences::find(std::size_t view, const TrackedView& tracked)
{
  std::optional<ViewReference>& reference = references_[view];
  if (reference && isOf(*reference, tracked))
  {
    return true;
  }
  const std::optional<PoseHistory::Entry> pose = history_.at(tracked.reference_stamp);
  if (!pose)
  {
    return false;
  }
  reference = ViewReference{ tracked.reference_stamp, tracked.region, pose->room_from_patient,
                             pose->room_from_patient, std::nullopt,   0,
                             pose->registered };
  return true;
}

ViewMeasurement ViewReferences::measurement(std::size_t view, const Track& track, std::int64_t stamp) const
{
  const ViewReference& reference = *references_[view];
  if (!reference.anchor)
  {
    return { reference.room_from_patient, track, std::nullopt };
  }
  return { reference.room_from_patient, track.since(*reference.anchor),
           1e-9 * static_cast<double>(std::abs(stamp - reference.anchor_stamp)) };
}

void ViewReferences::anchor(std::size_t view, const TrackedView& tracked, const Track& track, std::int64_t stamp,
                            const RigidTransform& room_from_patient, const std::optional<cv::Rect>& expected)
{
  std::optional<ViewReference>& reference = references_[view];
  if ((reference && reference->template_stamp > tracked.reference_stamp) || !track.warp().allFinite() ||
      !track.covariance.allFinite() || !(track.linear.determinant() > 0.0))
  {
    return;
  }
  if (!reference || !isOf(*reference, tracked))
  {
    // Learnt at a pose that is not known: what was learnt may be something that has passed in front of the target
    // since.
    const cv::Rect now = tracked.region + cv::Point(cvRound(track.displacement.x()), cvRound(track.displacement.y()));
    if (expected && 2 * (*expected & now).area() <= std::min(expected->area(), now.area()))
    {
      return;
    }
    // Where the one before would be, as what is off in many such tracks adds up.
    reference = ViewReference{ tracked.reference_stamp,
                               expected && expected->size() == now.size() ? *expected : now,
                               room_from_patient,
                               {},
                               {},
                               stamp,
                               true };
  }
  reference->room_from_patient = room_from_patient;
  reference->anchor = track;
  reference->anchor_stamp = stamp;
  reference->registered = true;
}

void ViewReferences::carry(const Refinement& refinement, const Eigen::Vector3d& target_centre)
{
  const auto correct = [&](const RigidTransform& pose) { return refinement.carry(pose, target_centre); };
  if (refinement.tracked)
  {
    history_.correctTracked(correct);
  }
  else
  {
    history_.forgetTracked();
  }
  for (std::optional<ViewReference>& reference : references_)
  {
    if (!reference || reference->registered)
    {
      continue;
    }
    if (refinement.tracked)
    {
      reference->learnt_at = correct(reference->learnt_at);
      reference->room_from_patient = correct(reference->room_from_patient);
      reference->registered = true;
    }
    else
    {
      reference->template_stamp = kNoTemplate;
    }
  }
}

std::optional<std::int64_t> ViewReferences::templateStamp(std::size_t view) const
{
  const std::optional<ViewReference>& reference = references_[view];
  return reference && reference->template_stamp != kNoTemplate ? std::make_optional(reference->template_stamp)
                                                               : std::nullopt;
}

std::optional<cv::Rect> ViewReferences::regionAt(std::size_t view, const ProjectionGeometry& geometry,
                                                 const RigidTransform& room_from_patient,
                                                 const Eigen::Vector3d& target_centre) const
{
  const std::optional<ViewReference>& reference = references_[view];
  if (!reference || reference->region.empty())
  {
    return std::nullopt;
  }
  const Eigen::Vector2d shift =
      geometry.project(room_from_patient * target_centre) - geometry.project(reference->learnt_at * target_centre);
  if (!(shift.cwiseAbs().maxCoeff() < 1e5))
  {
    return std::nullopt;
  }
  return reference->region + cv::Point(cvRound(shift.x()), cvRound(shift.y()));
}
}  // namespace xray_tracking
