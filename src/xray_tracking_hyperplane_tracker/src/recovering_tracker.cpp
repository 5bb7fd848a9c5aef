#include "xray_tracking_hyperplane_tracker/recovering_tracker.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <vector>

namespace xray_tracking
{
namespace
{
/// By so much what an image has left unexplained is forgotten in the next one.
constexpr double kForgetting = 0.1;
/// What is found again leaves at most so many times as much unexplained as the region usually did before the loss, and
/// is not asked to leave less than a twentieth.
constexpr double kAsBefore = 2.0;
constexpr double kLittle = 0.05;

double unexplained(const TrackResult& result)
{
  return 1.0 - result.correlation * result.correlation;
}
}  // namespace

void RecoveringTracker::train(const cv::Mat& image, const cv::Rect& region)
{
  tracker_->train(image, region);
  search_.emplace(image, region, intensity_, reduction_);
  last_good_.setZero();
  template_pixels_ = image(region).clone();
  usual_unexplained_.reset();
  lost_ = false;
}

void RecoveringTracker::reset()
{
  tracker_->reset();
  search_.reset();
}

const TrackResult& RecoveringTracker::track(const cv::Mat& image)
{
  if (!lost_)
  {
    result_ = tracker_->track(image);
    lost_ = !result_.found();
  }
  if (lost_)
  {
    recover(image);
  }
  if (!lost_)
  {
    last_good_ = result_.displacement;
  }
  if (!lost_ && result_.status == TrackResult::Status::TRACKED && !isTemplates(image))
  {
    const double latest = unexplained(result_);
    usual_unexplained_ = usual_unexplained_
                             ? std::max(latest, *usual_unexplained_ + kForgetting * (latest - *usual_unexplained_))
                             : latest;
  }
  return result_;
}

bool RecoveringTracker::isTemplates(const cv::Mat& image) const
{
  const cv::Mat pixels = image(tracker_->region());
  const std::size_t length = static_cast<std::size_t>(pixels.cols) * pixels.elemSize();
  for (int row = 0; row < pixels.rows; ++row)
  {
    if (std::memcmp(pixels.ptr(row), template_pixels_.ptr(row), length) != 0)
    {
      return false;
    }
  }
  return true;
}

bool RecoveringTracker::asBefore(const TrackResult& found) const
{
  return !usual_unexplained_ || unexplained(found) <= std::max(kLittle, kAsBefore * *usual_unexplained_);
}

void RecoveringTracker::recover(const cv::Mat& image)
{
  std::vector<Eigen::Vector2d> starts{ last_good_ };
  for (const RegionCandidate& candidate : search_->find(image))
  {
    starts.push_back(candidate.displacement);
  }
  // What one candidate is found by must not make it easier for the next one, or in the next image.
  const auto refine = [&](const Eigen::Vector2d& start)
  {
    tracker_->setLost();
    return tracker_->trackFrom(image, start);
  };
  std::vector<TrackResult> refined;
  std::transform(starts.begin(), starts.end(), std::back_inserter(refined), refine);
  const std::optional<std::size_t> proven = provenCandidate(refined, reduction_);
  if (proven && asBefore(refined[*proven]))
  {
    // The next search is to start from there, not from the last of the others.
    result_ = *proven + 1 < starts.size() ? refine(starts[*proven]) : refined[*proven];
    lost_ = !result_.found();
    return;
  }
  result_ = refined.front();
  if (result_.found())
  {
    result_.status = TrackResult::Status::LOW_CORRELATION;
  }
}
}  // namespace xray_tracking
