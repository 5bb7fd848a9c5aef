#include "xray_tracking_hyperplane_tracker/view_tracker.h"

#include <cmath>
#include <exception>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "state_names.h"

namespace xray_tracking
{
namespace
{
using State = ViewAnswer::State;

/// Share of the region outside the field from which on it is not looked for: what covers more than a quarter disturbs.
constexpr double kMostOutside = 0.5;

/// Why a region was not found.
const char* lossName(TrackResult::Status status)
{
  switch (status)
  {
    case TrackResult::Status::OUT_OF_IMAGE:
      return "the region has left the image";
    case TrackResult::Status::DIVERGED:
      return "the search for the region did not settle";
    default:
      return "nothing looks enough like the region";
  }
}

double finiteOrZero(double value)
{
  return std::isfinite(value) ? value : 0.0;
}
}  // namespace

ViewTracker::ViewTracker(std::unique_ptr<RegionTracker> tracker, const IntensityModel& intensity, int reduction,
                         MotionModel model, bool model_by_data, const std::optional<cv::Rect>& region,
                         const std::optional<cv::Size>& image_size)
  : tracker_(std::move(tracker), intensity, reduction),
    check_(intensity),
    intensity_(intensity),
    model_(model),
    model_by_data_(model_by_data),
    image_size_(image_size),
    configured_region_(region),
    wanted_region_(region)
{
}

void ViewTracker::requireSize(const cv::Mat& image) const
{
  if (image_size_ && image.size() != *image_size_)
  {
    std::ostringstream message;
    message << "the image is " << image.cols << " x " << image.rows << " px, expected the detector's image_size, "
            << image_size_->width << " x " << image_size_->height;
    throw std::invalid_argument(message.str());
  }
}

void ViewTracker::startAnew()
{
  tracker_.reset();
  check_.reset();
  reference_stamp_ns_ = 0;
}

void ViewTracker::takeUp(const cv::Mat& image, std::int64_t stamp_ns, const cv::Rect& wanted,
                         const std::optional<double>& usual)
{
  begin(stamp_ns, std::nullopt);
  requireSize(image);
  std::string fault = check_.look(image, stamp_ns);
  if (fault.empty())
  {
    fault = train(image, wanted, false);
  }
  if (!fault.empty())
  {
    startAnew();
    throw std::invalid_argument(fault);
  }
  tracker_.setLost(usual);
  wanted_region_ = wanted;
}

void ViewTracker::begin(std::int64_t stamp_ns, const std::optional<Training>& training)
{
  was_found_ = answer_.found();
  answer_ = ViewAnswer();
  answer_.model = model_;
  stamp_ns_ = stamp_ns;
  training_ = training;
  outcome_.reset();
  usable_ = false;
}

const ViewAnswer& ViewTracker::finished()
{
  if (tracker_.trained())
  {
    answer_.region = tracker_.region();
    answer_.reference_stamp_ns = reference_stamp_ns_;
    if (!answer_.found() && answer_.state != State::BLIND)
    {
      answer_.state = State::LOST;
    }
  }
  return answer_;
}

const ViewAnswer& ViewTracker::answer(const cv::Mat& image, std::int64_t stamp_ns,
                                      const std::optional<Training>& training)
{
  begin(stamp_ns, training);
  try
  {
    requireSize(image);
    answer_.fault = check_.look(image, stamp_ns);
    usable_ = answer_.fault.empty();
    if (usable_)
    {
      answerUsable(image);
    }
    else
    {
      // Neither a template nor a loss: the next one that shows something goes on from the last one that did.
      answer_.state = State::BLIND;
    }
  }
  catch (const std::exception& error)
  {
    answer_.fault = error.what();
    answer_.error = true;
  }
  return finished();
}

const ViewAnswer& ViewTracker::answerUnreadable(const std::string& fault)
{
  begin(stamp_ns_, std::nullopt);
  answer_.fault = fault;
  answer_.error = true;
  return finished();
}

void ViewTracker::answerUsable(const cv::Mat& image)
{
  if (!tracker_.trained())
  {
    if (training_ && training_->kind != Training::Kind::AGAIN)
    {
      outcome_ = serve(image);
    }
    if (!tracker_.trained() && wanted_region_)
    {
      answer_.fault = train(image, *wanted_region_, false);
      answer_.error = !answer_.fault.empty();
    }
  }
  if (!tracker_.trained())
  {
    return;
  }
  track(image);
  if (stamp_ns_ == reference_stamp_ns_)
  {
    // There it is by definition; what the tracker says is the image's noise.
    answer_.motion.displacement.setZero();
    answer_.motion.linear.setIdentity();
  }
}

std::string ViewTracker::learn(const cv::Mat& image)
{
  if (training_ && !outcome_)
  {
    outcome_ = usable_ ? serve(image) : answer_.fault;
  }
  return outcome_.value_or(std::string());
}

std::string ViewTracker::serve(const cv::Mat& image)
{
  try
  {
    switch (training_->kind)
    {
      case Training::Kind::AGAIN:
        return serveAgain(image);
      case Training::Kind::ANEW:
        if (!configured_region_)
        {
          startAnew();
          wanted_region_.reset();
          return std::string();
        }
        break;
      case Training::Kind::REGION:
        break;
    }
    const bool anew = training_->kind == Training::Kind::ANEW;
    if (anew && !tracker_.trained())
    {
      wanted_region_ = configured_region_;
    }
    const cv::Rect region = anew ? *configured_region_ : training_->region;
    std::string fault = train(image, region, anew);
    if (fault.empty())
    {
      wanted_region_ = region;
    }
    return fault;
  }
  catch (const std::exception& error)
  {
    return error.what();
  }
}

std::string ViewTracker::serveAgain(const cv::Mat& image)
{
  if (answer_.state != State::TRACKING)
  {
    return std::string("the region is ") + stateName(static_cast<std::uint8_t>(answer_.state)) + ", expected tracking";
  }
  return tracker_.retrain(check_.repaired(image)) ? std::string() : "the region was not found";
}

std::string ViewTracker::train(const cv::Mat& image, const cv::Rect& region, bool anew)
{
  try
  {
    ExposureCheck fresh(intensity_);
    if (anew)
    {
      fresh.look(image, stamp_ns_);
    }
    ExposureCheck& check = anew ? fresh : check_;
    const cv::Rect inside = check.learn(image, region);
    tracker_.train(check.repaired(image), inside);
    if (anew)
    {
      check_ = std::move(fresh);
    }
  }
  catch (const std::invalid_argument& error)
  {
    return error.what();
  }
  reference_stamp_ns_ = stamp_ns_;
  return std::string();
}

void ViewTracker::track(const cv::Mat& image)
{
  const double outside = check_.outside(tracker_.lastPlace());
  const bool covered = outside > kMostOutside;
  if (covered)
  {
    answer_.state = State::BLIND;
    answer_.fault = "of the region " + std::to_string(std::lround(100.0 * outside)) +
                    " % are outside the field (collimator blades, the image's rim)";
    // What was lost before may be elsewhere.
    if (!tracker_.lost())
    {
      return;
    }
  }
  const cv::Mat& repaired = check_.repaired(image);
  if (const std::string& mixed = check_.mixed(repaired, tracker_.lastPlace()); !mixed.empty())
  {
    answer_.state = State::BLIND;
    answer_.fault = mixed;
    return;
  }
  TrackResult track = tracker_.track(repaired);
  if (!track.found() && was_found_ && check_.learnStuck(image))
  {
    track = tracker_.track(check_.repaired(image));
  }
  if (model_by_data_ && !tellsRotation(track))
  {
    track = withoutLinearPart(track);
    answer_.model = MotionModel::TRANSLATION;
  }
  TrackResult& motion = answer_.motion;
  motion.correlation = finiteOrZero(track.correlation);
  motion.quality = finiteOrZero(track.quality);
  motion.iterations = track.iterations;
  // Nor is it found where there is nothing to be seen.
  const bool in_field = !covered || check_.outside(tracker_.lastPlace()) <= kMostOutside;
  if (in_field && track.found() && track.displacement.allFinite() && track.linear.allFinite() &&
      track.covariance.allFinite())
  {
    answer_.state = track.status == TrackResult::Status::TRACKED ? State::TRACKING : State::DEGRADED;
    motion.displacement = track.displacement;
    motion.linear = track.linear;
    motion.covariance = 0.5 * (track.covariance + track.covariance.transpose());  // rounding is not symmetric
    answer_.fault.clear();
  }
  else if (!covered)
  {
    answer_.state = State::LOST;
    answer_.fault = lossName(track.status);
  }
}
}  // namespace xray_tracking
