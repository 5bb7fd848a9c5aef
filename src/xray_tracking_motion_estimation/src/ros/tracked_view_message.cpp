#include "tracked_view_message.h"

#include <string>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::TrackedRegion;

static_assert(static_cast<int>(TrackModel::TRANSLATION) == TrackedRegion::TRANSLATION);
static_assert(static_cast<int>(TrackModel::EUCLIDEAN) == TrackedRegion::EUCLIDEAN);
static_assert(static_cast<int>(TrackModel::SIMILARITY) == TrackedRegion::SIMILARITY);
static_assert(static_cast<int>(TrackModel::AFFINE) == TrackedRegion::AFFINE);
static_assert(static_cast<int>(RegionState::UNTRAINED) == TrackedRegion::UNTRAINED);
static_assert(static_cast<int>(RegionState::TRAINING) == TrackedRegion::TRAINING);
static_assert(static_cast<int>(RegionState::TRACKING) == TrackedRegion::TRACKING);
static_assert(static_cast<int>(RegionState::LOST) == TrackedRegion::LOST);
static_assert(static_cast<int>(RegionState::DEGRADED) == TrackedRegion::DEGRADED);
static_assert(static_cast<int>(RegionState::BLIND) == TrackedRegion::BLIND);

bool isModel(std::uint8_t model)
{
  return model == TrackedRegion::TRANSLATION || model == TrackedRegion::EUCLIDEAN ||
         model == TrackedRegion::SIMILARITY || model == TrackedRegion::AFFINE;
}
}  // namespace

TrackedView trackedViewFromMsg(const TrackedRegion& region, std::int64_t offset)
{
  TrackedView view;
  view.fault = region.fault;
  view.reference_stamp = nanosecondsFromTime(region.reference_stamp);
  view.offset = offset;
  // A region that is none, of a message from elsewhere, is not known. Twice its area is an int.
  constexpr std::uint32_t kMostPixels = 30000;
  const auto& r = region.region;
  if (std::max({ r.x_offset, r.y_offset, r.width, r.height }) < kMostPixels)
  {
    view.region = cv::Rect(static_cast<int>(r.x_offset), static_cast<int>(r.y_offset), static_cast<int>(r.width),
                           static_cast<int>(r.height));
  }
  const bool found = region.state == TrackedRegion::TRACKING || region.state == TrackedRegion::DEGRADED;
  if (region.state > TrackedRegion::BLIND)
  {
    view.state = RegionState::LOST;
    view.fault = "unknown state " + std::to_string(region.state);
  }
  else if (found && !isModel(region.model))
  {
    view.state = RegionState::LOST;
    view.fault = "unknown model " + std::to_string(region.model);
  }
  else
  {
    view.state = static_cast<RegionState>(region.state);
  }
  if (view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED)
  {
    view.track.centre = { r.x_offset + (r.width - 1.0) / 2.0, r.y_offset + (r.height - 1.0) / 2.0 };
    view.track.model = static_cast<TrackModel>(region.model);
    view.track.displacement = { region.displacement_x, region.displacement_y };
    view.track.linear = Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(region.linear.data());
    view.track.covariance = Eigen::Map<const Matrix6d>(region.covariance.data()).transpose();
  }
  return view;
}
}  // namespace xray_tracking
