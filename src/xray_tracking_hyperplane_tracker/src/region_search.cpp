#include "xray_tracking_hyperplane_tracker/region_search.h"

#include <algorithm>

#include <opencv2/imgproc.hpp>

#include "point_sampler.h"
#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr int kCandidates = 5;
/// The coarse region is at least so large, if the region is [coarse px].
constexpr int kSmallestPatch = 12;
constexpr int kLargestBin = 4;
/// What is slower counts as shading [px]: about a vertebra.
constexpr double kShadingSigma = 24.0;
/// A candidate correlates at least by this share of the best one.
constexpr double kWorthRefining = 0.5;
/// Of the variance that the second best place leaves unexplained, the best one leaves at most this share. Chance alone
/// makes the two differ by sqrt(2 / independent points), a tenth for 200.
constexpr double kClearlyLess = 0.8;
/// Answers this near are the same place [px].
constexpr double kSamePlace = 3.0;

/// Of the parabola through three neighbours of which the middle one is the greatest.
double vertex(double before, double middle, double after)
{
  const double curvature = before - 2.0 * middle + after;
  return curvature < 0.0 ? 0.5 * (before - after) / curvature : 0.0;
}

Eigen::Vector2d subpixelPeak(const cv::Mat& scores, const cv::Point& p)
{
  const auto at = [&scores](int x, int y) { return static_cast<double>(scores.at<float>(y, x)); };
  Eigen::Vector2d place(p.x, p.y);
  if (p.x > 0 && p.x < scores.cols - 1)
  {
    place.x() += vertex(at(p.x - 1, p.y), at(p.x, p.y), at(p.x + 1, p.y));
  }
  if (p.y > 0 && p.y < scores.rows - 1)
  {
    place.y() += vertex(at(p.x, p.y - 1), at(p.x, p.y), at(p.x, p.y + 1));
  }
  return place;
}

double unexplained(const TrackResult& result)
{
  return 1.0 - result.quality * result.quality;
}
}  // namespace

RegionSearch::RegionSearch(const cv::Mat& image, const cv::Rect& region, const IntensityModel& intensity, int reduction)
  : intensity_(intensity),
    bin_(std::clamp(std::min(region.width, region.height) / kSmallestPatch, 1, kLargestBin * reduction)),
    shading_(kShadingSigma * reduction / bin_),
    region_(region.x / bin_, region.y / bin_, region.width / bin_, region.height / bin_)
{
  checkImage(image);
  const cv::Mat whole = coarse(image);
  region_ &= cv::Rect(cv::Point(), whole.size());
  patch_ = whole(region_).clone();
}

cv::Mat RegionSearch::coarse(const cv::Mat& image) const
{
  // The mean of the logarithms is the logarithm of the mean but for the square of the contrast within a coarse pixel.
  cv::Mat small, slow;
  cv::resize(image, small, { image.cols / bin_, image.rows / bin_ }, 0.0, 0.0, cv::INTER_AREA);
  cv::Mat values = attenuationImage(small, intensity_);
  cv::GaussianBlur(values, slow, cv::Size(), shading_, 0.0, cv::BORDER_REPLICATE);
  return values - slow;
}

std::vector<RegionCandidate> RegionSearch::find(const cv::Mat& image) const
{
  checkImage(image);
  const cv::Size margin(patch_.cols / 4, patch_.rows / 4);
  cv::Mat padded, scores;
  cv::copyMakeBorder(coarse(image), padded, margin.height, margin.height, margin.width, margin.width,
                     cv::BORDER_CONSTANT, cv::Scalar(0.0));
  if (padded.cols < patch_.cols || padded.rows < patch_.rows)
  {
    return {};
  }
  cv::matchTemplate(padded, patch_, scores, cv::TM_CCOEFF_NORMED);
  cv::patchNaNs(scores, -1.0);

  std::vector<RegionCandidate> candidates;
  cv::Mat open(scores.size(), CV_8UC1, cv::Scalar(255));
  while (candidates.size() < kCandidates && cv::countNonZero(open) > 0)
  {
    double score;
    cv::Point best;
    cv::minMaxLoc(scores, nullptr, &score, nullptr, &best, open);
    if (score <= 0.0 || (!candidates.empty() && score < kWorthRefining * candidates.front().correlation))
    {
      break;
    }
    const Eigen::Vector2d place =
        subpixelPeak(scores, best) - Eigen::Vector2d(margin.width + region_.x, margin.height + region_.y);
    candidates.push_back({ bin_ * place, score });
    const cv::Rect taken(best - cv::Point(margin.width, margin.height), margin * 2 + cv::Size(1, 1));
    open(taken & cv::Rect(cv::Point(), open.size())).setTo(0);
  }
  return candidates;
}

std::optional<std::size_t> provenCandidate(const std::vector<TrackResult>& refined, int reduction)
{
  std::optional<std::size_t> best;
  for (std::size_t i = 0; i < refined.size(); ++i)
  {
    if (refined[i].status == TrackResult::Status::TRACKED && (!best || refined[i].quality > refined[*best].quality))
    {
      best = i;
    }
  }
  if (!best)
  {
    return std::nullopt;
  }
  for (const TrackResult& other : refined)
  {
    const bool elsewhere = (other.displacement - refined[*best].displacement).norm() > kSamePlace * reduction;
    if (elsewhere && unexplained(refined[*best]) > kClearlyLess * unexplained(other))
    {
      return std::nullopt;
    }
  }
  return best;
}
}  // namespace xray_tracking
