#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "contestant.h"

namespace xray_tracking
{
namespace
{
cv::Point2d centreOf(const cv::Rect& region)
{
  return { region.x + (region.width - 1) / 2.0, region.y + (region.height - 1) / 2.0 };
}

/// The rectangle of `margin` around the region at a displacement, within the image.
cv::Rect around(const cv::Rect& region, const Eigen::Vector2d& displacement, int margin, const cv::Size& image)
{
  const cv::Point shift(cvRound(displacement.x()), cvRound(displacement.y()));
  const cv::Rect grown =
      cv::Rect(region.tl() + shift - cv::Point(margin, margin), region.size() + cv::Size(2 * margin, 2 * margin));
  return grown & cv::Rect(cv::Point(), image);
}

/// What the contestants that keep a patch of the first image and a displacement have in common.
class PatchContestant : public Contestant
{
public:
  using Contestant::Contestant;

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    region_ = view.regionInWindow();
    patch_ = frame.normalised(region_).clone();
    displacement_.setZero();
  }
  void restart() override { displacement_.setZero(); }

protected:
  cv::Rect region_;
  cv::Mat patch_;
  Eigen::Vector2d displacement_ = Eigen::Vector2d::Zero();
};

class Ecc : public PatchContestant
{
public:
  Ecc(const std::string& name, int motion_type) : PatchContestant(name), motion_type_(motion_type) {}

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    PatchContestant::train(frame, view);
    restart();
  }
  void restart() override
  {
    PatchContestant::restart();
    warp_ = cv::Mat::eye(2, 3, CV_32F);
    warp_.at<float>(0, 2) = static_cast<float>(region_.x);
    warp_.at<float>(1, 2) = static_cast<float>(region_.y);
  }
  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    // The whole image would be filtered at every call.
    const cv::Rect window = around(region_, displacement_, kMargin, frame.normalised.size());
    cv::Mat warp = warp_.clone();
    warp.at<float>(0, 2) -= static_cast<float>(window.x);
    warp.at<float>(1, 2) -= static_cast<float>(window.y);
    try
    {
      cv::findTransformECC(patch_, frame.normalised(window), warp, motion_type_,
                           cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 50, 1e-4), cv::noArray(),
                           5);
    }
    catch (const cv::Exception&)  // its way to say that it does not converge
    {
      return std::nullopt;
    }
    warp.at<float>(0, 2) += static_cast<float>(window.x);
    warp.at<float>(1, 2) += static_cast<float>(window.y);
    warp_ = warp;
    const double x = (region_.width - 1) / 2.0;
    const double y = (region_.height - 1) / 2.0;
    const cv::Point2d centre = centreOf(region_);
    displacement_ = { warp.at<float>(0, 0) * x + warp.at<float>(0, 1) * y + warp.at<float>(0, 2) - centre.x,
                      warp.at<float>(1, 0) * x + warp.at<float>(1, 1) * y + warp.at<float>(1, 2) - centre.y };
    return displacement_;
  }

private:
  static constexpr int kMargin = 40;

  int motion_type_;
  cv::Mat warp_;
};

class PhaseCorrelation : public PatchContestant
{
public:
  PhaseCorrelation() : PatchContestant("OpenCV phaseCorrelate") {}

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    PatchContestant::train(frame, view);
    frame.normalised.convertTo(first_, CV_32F);
    cv::createHanningWindow(hanning_, region_.size(), CV_32F);
  }
  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    // Twice, because the window that the first answer gives shows more of the region.
    Eigen::Vector2d displacement = displacement_;
    for (int i = 0; i < 2; ++i)
    {
      const cv::Rect window = around(region_, displacement, 0, first_.size());
      if (window.size() != region_.size())
      {
        return std::nullopt;
      }
      cv::Mat found;
      frame.normalised(window).convertTo(found, CV_32F);
      const cv::Point2d shift = cv::phaseCorrelate(first_(region_), found, hanning_);
      displacement = { window.x - region_.x + shift.x, window.y - region_.y + shift.y };
    }
    displacement_ = displacement;
    return displacement;
  }

private:
  cv::Mat first_;
  cv::Mat hanning_;
};

class MatchTemplate : public PatchContestant
{
public:
  MatchTemplate() : PatchContestant("OpenCV matchTemplate") {}

  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    const cv::Rect window = around(region_, displacement_, kSearch, frame.normalised.size());
    if (window.width < patch_.cols || window.height < patch_.rows)
    {
      return std::nullopt;
    }
    cv::Mat scores;
    cv::matchTemplate(frame.normalised(window), patch_, scores, cv::TM_CCOEFF_NORMED);
    cv::Point best;
    double score;
    cv::minMaxLoc(scores, nullptr, &score, nullptr, &best);
    if (score < 0.3)
    {
      return std::nullopt;
    }
    const auto at = [&scores](int x, int y) { return static_cast<double>(scores.at<float>(y, x)); };
    Eigen::Vector2d offset = Eigen::Vector2d::Zero();
    if (best.x > 0 && best.x < scores.cols - 1)
    {
      offset.x() = vertex(at(best.x - 1, best.y), score, at(best.x + 1, best.y));
    }
    if (best.y > 0 && best.y < scores.rows - 1)
    {
      offset.y() = vertex(at(best.x, best.y - 1), score, at(best.x, best.y + 1));
    }
    displacement_ = Eigen::Vector2d(window.x + best.x - region_.x, window.y + best.y - region_.y) + offset;
    return displacement_;
  }

private:
  /// Of the search around the last place [px].
  static constexpr int kSearch = 24;

  /// Of the parabola through three neighbours of which the middle one is the greatest.
  static double vertex(double before, double middle, double after)
  {
    const double curvature = before - 2.0 * middle + after;
    return curvature < 0.0 ? 0.5 * (before - after) / curvature : 0.0;
  }
};

/// The median of the flow of the corners and of a grid.
class LucasKanade : public PatchContestant
{
public:
  LucasKanade() : PatchContestant("OpenCV Lucas-Kanade, median") {}

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    PatchContestant::train(frame, view);
    cv::buildOpticalFlowPyramid(frame.normalised, pyramid_, kWindow, kLevels);
    cv::goodFeaturesToTrack(patch_, corners_, 150, 0.01, 5.0);
    for (cv::Point2f& corner : corners_)
    {
      corner += cv::Point2f(region_.tl());
    }
  }
  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    const cv::Point2f start(static_cast<float>(displacement_.x()), static_cast<float>(displacement_.y()));
    std::vector<cv::Point2f> places = corners_;
    for (cv::Point2f& place : places)
    {
      place += start;
    }
    std::vector<cv::Mat> pyramid;
    cv::buildOpticalFlowPyramid(frame.normalised, pyramid, kWindow, kLevels);
    std::vector<std::uint8_t> found;
    cv::calcOpticalFlowPyrLK(pyramid_, pyramid, corners_, places, found, cv::noArray(), kWindow, kLevels,
                             cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 30, 0.01),
                             cv::OPTFLOW_USE_INITIAL_FLOW);
    std::vector<double> x, y;
    for (std::size_t i = 0; i < places.size(); ++i)
    {
      if (found[i] != 0)
      {
        x.push_back(places[i].x - corners_[i].x);
        y.push_back(places[i].y - corners_[i].y);
      }
    }
    if (2 * x.size() < corners_.size())
    {
      return std::nullopt;
    }
    displacement_ = { median(x), median(y) };
    return displacement_;
  }

private:
  static inline const cv::Size kWindow{ 21, 21 };
  static constexpr int kLevels = 3;

  static double median(std::vector<double>& values)
  {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  }

  std::vector<cv::Mat> pyramid_;
  std::vector<cv::Point2f> corners_;
};
}  // namespace

void addOpenCv(MotionModel model, Contestants& contestants)
{
  switch (model)
  {
    case MotionModel::TRANSLATION:
      contestants.push_back(std::make_unique<Ecc>("OpenCV ECC, translation", cv::MOTION_TRANSLATION));
      break;
    case MotionModel::EUCLIDEAN:
      contestants.push_back(std::make_unique<Ecc>("OpenCV ECC, Euclidean", cv::MOTION_EUCLIDEAN));
      break;
    case MotionModel::SIMILARITY:
    case MotionModel::AFFINE:
      contestants.push_back(std::make_unique<Ecc>("OpenCV ECC, affine", cv::MOTION_AFFINE));
      break;
  }
  contestants.push_back(std::make_unique<PhaseCorrelation>());
  contestants.push_back(std::make_unique<MatchTemplate>());
  contestants.push_back(std::make_unique<LucasKanade>());
}
}  // namespace xray_tracking
