#include "likeness.h"

#include <algorithm>
#include <cstdio>
#include <numeric>

#include <boost/math/constants/constants.hpp>
#include <opencv2/imgproc.hpp>

#include "../recording_check/pose_readings.h"
#include "xray_tracking_core/image/attenuation.h"
#include "xray_tracking_core/image/xray_field.h"

namespace xray_tracking
{
namespace
{
constexpr int kTargetSize = 64;               // bins that the target's longer side has
constexpr int kLeast = 16;                    // bins or pixels, of what can be compared
constexpr double kFine = 1.0, kCoarse = 6.0;  // bins
// Of what is told: better by this, and alike. Of thorax_01 and _02, the knee, the wrist and the portal images 0.60 to
// 1.00 are right poses (mean of the views 0.65 and more), 0.32 to 0.58 mostly those turned by 180 degrees and mirrored
// images.
constexpr double kBetter = 0.2;
constexpr double kAlike = 0.45;
constexpr double kRight = 0.6;
constexpr double kReach = 60.0;  // mm; what is like it from farther away is something else

/// Without what is smooth, and without noise.
cv::Mat detailsOf(const cv::Mat& image)
{
  cv::Mat fine, coarse;
  cv::GaussianBlur(image, fine, {}, kFine);
  cv::GaussianBlur(image, coarse, {}, kCoarse);
  return fine - coarse;
}

/// Where a DRR's part is most like an X-ray.
struct Match
{
  double likeness = 0.0;
  double away = 0.0;  ///< from where it should be, mm at the target
};

/// Of a detector, in bins.
class CoarseView
{
public:
  CoarseView(const TreatmentSetup& setup, const ProjectionGeometry& detector, const cv::Mat& xray)
    : setup_(setup), detector_(detector)
  {
    // Whatever the pose is: as the target is seen from its distance in the middle of the room.
    const double extent = setup.target_box.sizes().maxCoeff() * detector.focalLength().x() /
                          std::max(0.5 * detector.sourceToDetector(), detector.depth(Eigen::Vector3d::Zero()));
    bin_ = std::max(1, static_cast<int>(extent / kTargetSize));
    grid_ = PixelGrid::binnedRegion(Eigen::Vector2i::Zero(), detector.imageSize(), bin_);
    if (xray.cols < kLeast || xray.rows < kLeast || grid_.size.minCoeff() < kLeast)
    {
      return;
    }
    cv::Mat attenuation = attenuationImage(xray, setup.intensity);
    XrayField field;
    field.update(xray, setup.intensity);
    if (field.nothing().empty())
    {
      cv::Mat outside = cv::Mat::zeros(xray.size(), CV_8UC1);
      field.mark(cv::Rect({}, xray.size()), 1, outside);
      attenuation.setTo(cv::mean(attenuation, outside == 0), outside);
    }
    const cv::Size size(grid_.size.x(), grid_.size.y());
    cv::Mat binned;
    cv::resize(attenuation(cv::Rect({}, size * bin_)), binned, size, 0, 0, cv::INTER_AREA);
    details_ = detailsOf(binned);
  }

  /// @param flip of the X-ray, as cv::flip has it: 1 left to right, 0 upside down, -1 both
  Match match(const ShearWarpRenderer& renderer, const RigidTransform& pose, std::optional<int> flip = {}) const
  {
    TreatmentSetup there = setup_;
    there.room_from_patient = pose;
    const cv::Rect seen = projectedTargetRegion(there, detector_);
    const cv::Rect whole(0, 0, grid_.size.x(), grid_.size.y());
    const cv::Rect target = cv::Rect(seen.tl() / bin_, seen.br() / bin_) & whole;
    if (details_.empty() || target.width < kLeast || target.height < kLeast)
    {
      return {};
    }
    cv::Mat drr;
    renderer.render(detector_, grid_, pose, drr);
    const cv::Mat part = detailsOf(drr)(target);
    cv::Scalar mean, deviation;
    cv::meanStdDev(part, mean, deviation);
    cv::Mat xray = details_;
    if (flip)
    {
      cv::flip(details_, xray, *flip);
    }
    cv::Mat correlation;
    cv::matchTemplate(xray, part, correlation, cv::TM_CCOEFF_NORMED);
    double best = 0.0;
    cv::Point place;
    cv::minMaxLoc(correlation, nullptr, &best, nullptr, &place);
    if (!(deviation[0] > 0.0) || !(std::abs(best) <= 1.0 + 1e-3))
    {
      return {};
    }
    const double depth = detector_.depth(pose * setup_.targetCentre());
    return { best, cv::norm(place - target.tl()) * bin_ * depth / detector_.focalLength().x() };
  }

private:
  const TreatmentSetup& setup_;
  const ProjectionGeometry& detector_;
  int bin_ = 1;
  PixelGrid grid_;
  cv::Mat details_;
};

double mean(const std::vector<double>& values)
{
  return std::accumulate(values.begin(), values.end(), 0.0) / std::max<std::size_t>(1, values.size());
}

std::string compared(double other, double given)
{
  char text[80];
  std::snprintf(text, sizeof(text), " (correlation %.2f, as it is %.2f)", other, given);
  return text;
}
}  // namespace

Likeness likenessOf(const TreatmentSetup& setup, const ShearWarpRenderer& renderer, const std::vector<cv::Mat>& xrays)
{
  Likeness likeness;
  std::vector<CoarseView> views;
  std::string away;
  double farthest = 0.0;
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    views.emplace_back(setup, setup.detectors[d], xrays[d]);
    const Match match = views[d].match(renderer, setup.room_from_patient);
    likeness.views.push_back(match.likeness);
    farthest = std::max(farthest, match.away);
    if (match.away > kNearMm)
    {
      char text[40];
      std::snprintf(text, sizeof(text), "%s%.0f mm (", away.empty() ? "" : ", ", match.away);
      away += text + setup.detectors[d].name() + ")";
    }
  }

  // The whole patient, about his target, or as the pose may have been meant.
  std::vector<std::pair<std::string, RigidTransform>> poses;
  const char* const axes[] = { "left-right", "back-front", "head-feet" };
  for (int axis = 0; axis < 3; ++axis)
  {
    const Eigen::Translation3d centre(setup.targetCentre());
    poses.emplace_back(std::string("the patient turned by 180 degrees about his ") + axes[axis] + " axis",
                       setup.room_from_patient * centre *
                           Eigen::AngleAxisd(boost::math::constants::pi<double>(), Eigen::Vector3d::Unit(axis)) *
                           centre.inverse());
  }
  for (const PoseReading& reading : otherReadings(setup))
  {
    if (!reading.swapped && !reading.other_tone && targetShare(setup, reading.room_from_patient) > 0.0)
    {
      poses.emplace_back("initial_pose as " + reading.words, reading.room_from_patient);
    }
  }
  double best = std::max(kAlike, mean(likeness.views) + kBetter);
  std::string words;
  std::vector<double> explained = likeness.views;  // by the best of them
  for (const auto& [what, pose] : poses)
  {
    std::vector<double> of_pose;
    for (const CoarseView& view : views)
    {
      of_pose.push_back(view.match(renderer, pose).likeness);
    }
    if (mean(of_pose) > best)
    {
      best = mean(of_pose);
      explained = of_pose;
      words = "the images look like the DRRs with " + what + compared(best, mean(likeness.views));
    }
  }
  if (words.empty() && !away.empty() && farthest <= kReach && mean(likeness.views) >= kRight)
  {
    words = "the images look like the DRRs, but away from where initial_pose puts the target: " + away;
  }
  if (!words.empty())
  {
    likeness.words.push_back(words);
  }

  const std::pair<int, const char*> flips[] = { { 1, "left to right" },
                                                { 0, "upside down" },
                                                { -1, "by 180 degrees" } };
  for (std::size_t d = 0; d < views.size(); ++d)
  {
    double most = std::max(kAlike, explained[d] + kBetter);
    std::string of_view;
    for (const auto& [flip, how] : flips)
    {
      const double flipped = views[d].match(renderer, setup.room_from_patient, flip).likeness;
      if (flipped > most)
      {
        most = flipped;
        of_view = "the image of " + setup.detectors[d].name() + " looks like its DRR when it is turned " + how +
                  compared(flipped, likeness.views[d]);
      }
    }
    if (!of_view.empty())
    {
      likeness.words.push_back(of_view);
    }
  }
  if (likeness.words.empty() && mean(likeness.views) < kRight)
  {
    char text[160];
    std::snprintf(
        text, sizeof(text),
        "the images are not much like the DRRs: correlation %.2f in the mean, of the right poses that this was "
        "tried on %.1f or more",
        mean(likeness.views), kRight);
    likeness.words.emplace_back(text);
  }
  return likeness;
}
}  // namespace xray_tracking
