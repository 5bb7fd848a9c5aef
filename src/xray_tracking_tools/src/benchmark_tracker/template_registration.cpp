#include "template_registration.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/core/optim.hpp>

#include "binned_image.h"
#include "image_similarity.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
/// Coarse to fine [px]; the smoothed images have nothing finer to show.
constexpr std::array<int, 2> kBins{ 4, 2 };
/// Around a region, for what is to be seen of it [px]: the smoothness of the shading and rotations.
constexpr int kMargin = 24;
/// The histogram reaches so many robust standard deviations to both sides of zero.
constexpr double kHistogramReach = 3.0;
/// Share of the region outside the image with which it still counts as found.
constexpr double kMaxOutside = 0.25;
/// Share of the region that must look like the template, and below which the result is marked as degraded.
constexpr double kLeastSeen = 0.5;
constexpr double kMostlySeen = 0.85;

using Motion = PlanarRigidMotion;

cv::Rect grown(const cv::Rect& rect, int margin)
{
  return rect + cv::Size(2 * margin, 2 * margin) - cv::Point(margin, margin);
}

Eigen::Vector2d centreOf(const cv::Rect& region)
{
  return { region.x + (region.width - 1) / 2.0, region.y + (region.height - 1) / 2.0 };
}

std::string described(const cv::Size& size, int type)
{
  return std::to_string(size.width) + " x " + std::to_string(size.height) + " of OpenCV's type " + std::to_string(type);
}

std::string described(const cv::Rect& region)
{
  return "region: " + std::to_string(region.width) + " x " + std::to_string(region.height) + " at (" +
         std::to_string(region.x) + ", " + std::to_string(region.y) + ")";
}

/// As RegionTracker::train asks for.
void requireUsable(const cv::Mat& image, const cv::Rect& region)
{
  constexpr int kMinSize = 16;
  if (image.type() != CV_8UC1 && image.type() != CV_16UC1)
  {
    throw std::invalid_argument("image: is " + described(image.size(), image.type()) +
                                ", expected CV_8UC1 or CV_16UC1");
  }
  if (std::min(region.width, region.height) < kMinSize || (region & cv::Rect(cv::Point(), image.size())) != region)
  {
    throw std::invalid_argument(described(region) + " in an image of " + described(image.size(), image.type()) +
                                ", expected inside and " + std::to_string(kMinSize) + " px or more both ways");
  }
}

/// Root mean square distance of the region's points from its centre [px].
double radiusOf(const cv::Rect& region)
{
  return std::sqrt((region.width * region.width + region.height * region.height) / 12.0);
}

/// The same image with values that count in a histogram's bins, its ends where something stands out by far.
BinnedImage inHistogramBins(const BinnedImage& image, int bins)
{
  const double deviation = kDeviationOfMedian * medianMagnitude(image.values);
  const double middle = 0.5 * (bins - 1);
  const double gain = deviation > 0.0 ? middle / (kHistogramReach * deviation) : 0.0;
  BinnedImage scaled = image;
  image.values.convertTo(scaled.values, CV_32F, gain, middle);
  scaled.values = cv::min(cv::max(scaled.values, 0.0), bins - 1.0);
  return scaled;
}

/// Similarity of template and image as a function of the motion, for the solver: negative, of parameters that all count
/// in pixels, the rotation's at the region's radius.
class Dissimilarity : public cv::MinProblemSolver::Function
{
public:
  Dissimilarity(const TemplateRegistrationOptions& options, const cv::Rect& region)
    : by_gradients_(options.similarity == TemplateRegistrationOptions::Similarity::GRADIENT_CORRELATION),
      dimensions_(options.model == MotionModel::EUCLIDEAN ? 3 : 2),
      centre_(centreOf(region)),
      radius_(radiusOf(region)),
      mutual_information_(options.bins)
  {
  }

  /// @param reference, image of the same bin; they must live as long as this is used
  void setLevel(const BinnedImage& reference, const BinnedImage& image)
  {
    reference_ = &reference;
    image_ = &image;
  }
  double of(const Motion& motion) const
  {
    ++evaluations_;
    sampleMoved(*reference_, centre_, motion, *image_, moved_);
    return by_gradients_ ? -gradientCorrelation(reference_->values, moved_)
                         : -mutual_information_(reference_->values, moved_);
  }
  int evaluations() const { return evaluations_; }

  int getDims() const override { return dimensions_; }
  double calc(const double* x) const override { return of(motion(x)); }

  Motion motion(const double* x) const { return { x[0], x[1], dimensions_ == 3 ? x[2] / radius_ : 0.0 }; }
  cv::Mat parameters(const Motion& motion) const
  {
    cv::Mat x(1, dimensions_, CV_64F);
    for (int i = 0; i < dimensions_; ++i)
    {
      x.at<double>(i) = motion[i] * (i == 2 ? radius_ : 1.0);
    }
    return x;
  }

private:
  bool by_gradients_;
  int dimensions_;
  Eigen::Vector2d centre_;
  double radius_;
  const BinnedImage* reference_ = nullptr;
  const BinnedImage* image_ = nullptr;
  // Scratch memory and a count, which the solver's interface makes part of a constant object.
  mutable NormalisedMutualInformation mutual_information_;
  mutable cv::Mat moved_;
  mutable int evaluations_ = 0;
};

/// Of all displacements within the range, in steps of one binned pixel.
Motion bestOnGrid(const Dissimilarity& dissimilarity, const Motion& start, double range, int bin)
{
  Motion best = start;
  double least = std::numeric_limits<double>::infinity();
  const int steps = static_cast<int>(std::ceil(range / bin));
  for (int j = -steps; j <= steps; ++j)
  {
    for (int i = -steps; i <= steps; ++i)
    {
      const Motion motion = start + Motion(i * bin, j * bin, 0.0);
      const double value = dissimilarity.of(motion);
      if (value < least)
      {
        least = value;
        best = motion;
      }
    }
  }
  return best;
}

/// @param edge of the first simplex [px]
Motion descend(const cv::Ptr<Dissimilarity>& dissimilarity, const Motion& start, double edge)
{
  constexpr int kMaxEvaluations = 120;
  // Of similarity: near its peak less than a hundredth of a pixel changes it by.
  constexpr double kPrecision = 1e-6;
  cv::Mat x = dissimilarity->parameters(start);
  cv::DownhillSolver::create(
      dissimilarity, cv::Mat(1, x.cols, CV_64F, cv::Scalar(edge)),
      cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, kMaxEvaluations, kPrecision))
      ->minimize(x);
  return dissimilarity->motion(x.ptr<double>());
}

/// Of the displacement and the four linear parts, if what the template leaves unexplained is white noise, smoothed.
Eigen::Matrix<double, 6, 6> covarianceOf(const BinnedImage& reference, const Agreement& agreement, MotionModel model,
                                         const Eigen::Vector2d& centre, const Motion& motion)
{
  const int dimensions = static_cast<int>(model);
  const cv::Mat& values = reference.values;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (int y = 1; y < values.rows - 1; ++y)
  {
    for (int x = 1; x < values.cols - 1; ++x)
    {
      if (agreement.inliers.at<std::uint8_t>(y, x) != 0)
      {
        const double gx = (values.at<float>(y, x + 1) - values.at<float>(y, x - 1)) / (2.0 * reference.bin);
        const double gy = (values.at<float>(y + 1, x) - values.at<float>(y - 1, x)) / (2.0 * reference.bin);
        const Eigen::Vector2d p = reference.place(x, y) - centre;
        const Eigen::Vector3d slope(gx, gy, gy * p.x() - gx * p.y());
        information += slope * slope.transpose();
      }
    }
  }
  cv::Scalar mean, deviation;
  cv::meanStdDev(values, mean, deviation, agreement.inliers);
  const double explained = std::max(1e-6, agreement.correlation * agreement.correlation);
  // Neighbours share their noise: its autocorrelation, exp(-distance^2 / 4 sigma^2), sums up to 4 pi sigma^2 pixels.
  const double together = 4.0 * M_PI * kSmoothing * kSmoothing / (reference.bin * reference.bin);
  const double variance = together * deviation[0] * deviation[0] * (1.0 - explained) / explained;
  // d(displacement, linear) / d(displacement, rotation)
  Eigen::Matrix<double, 6, 3> derivative = Eigen::Matrix<double, 6, 3>::Zero();
  derivative.topLeftCorner<2, 2>().setIdentity();
  derivative.col(2).tail<4>() << -std::sin(motion[2]), -std::cos(motion[2]), std::cos(motion[2]), -std::sin(motion[2]);
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  covariance.topLeftCorner(dimensions, dimensions) =
      variance * information.topLeftCorner(dimensions, dimensions).inverse();
  return derivative * covariance * derivative.transpose();
}
}  // namespace

void TemplateRegistrationOptions::validate() const
{
  requireOption(model == MotionModel::TRANSLATION || model == MotionModel::EUCLIDEAN, "model", static_cast<int>(model),
                "2 (translation) or 3 (Euclidean) parameters");
  requireInRange("bins", bins, 4, 256);
  requireInRange("range", range, 1.0, 200.0);
  requireInRange("min_correlation", min_correlation, 0.0, 1.0);
  requireInRange("found_correlation", found_correlation, min_correlation, 1.0);
}

struct TemplateRegistration::Template
{
  cv::Size size;
  int type = 0;
  cv::Rect region;
  std::array<BinnedImage, kBins.size()> references;  ///< in histogram bins
  BinnedImage fine;                                  ///< the last of them, values as they are
};

TemplateRegistration::TemplateRegistration(const TemplateRegistrationOptions& options, const IntensityModel& intensity)
  : options_(options), intensity_(intensity)
{
  options_.validate();
}

TemplateRegistration::~TemplateRegistration() = default;
TemplateRegistration::TemplateRegistration(TemplateRegistration&&) noexcept = default;
TemplateRegistration& TemplateRegistration::operator=(TemplateRegistration&&) noexcept = default;

void TemplateRegistration::reset()
{
  template_.reset();
}

cv::Rect TemplateRegistration::region() const
{
  return template_ ? template_->region : cv::Rect();
}

void TemplateRegistration::train(const cv::Mat& image, const cv::Rect& region)
{
  requireUsable(image, region);
  const cv::Rect part = grown(region, kMargin) & cv::Rect(cv::Point(), image.size());
  const cv::Mat values = sharpPart(image, part, intensity_)(region - part.tl());
  cv::Scalar mean, deviation;
  cv::meanStdDev(values, mean, deviation);
  if (!(deviation[0] > 0.0))
  {
    throw std::invalid_argument(described(region) + " has no contrast");
  }

  auto learnt = std::make_unique<Template>();
  learnt->size = image.size();
  learnt->type = image.type();
  learnt->region = region;
  for (std::size_t level = 0; level < kBins.size(); ++level)
  {
    learnt->fine = binned(values, region.tl(), kBins[level]);
    learnt->references[level] = inHistogramBins(learnt->fine, options_.bins);
  }
  template_ = std::move(learnt);
  last_good_.setZero();
  lost_ = false;
  result_ = TrackResult();
  result_.correlation = 1.0;
  result_.quality = 1.0;
}

const TrackResult& TemplateRegistration::track(const cv::Mat& image)
{
  return registerFrom(image, last_good_);
}

const TrackResult& TemplateRegistration::trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement)
{
  const bool was_lost = lost_;
  if (!registerFrom(image, { displacement.x(), displacement.y(), 0.0 }).found())
  {
    lost_ = was_lost;
  }
  return result_;
}

const TrackResult& TemplateRegistration::registerFrom(const cv::Mat& image, const Eigen::Vector3d& start)
{
  if (!template_)
  {
    throw std::logic_error("TemplateRegistration::track without a template");
  }
  const Template& t = *template_;
  if (image.size() != t.size || image.type() != t.type)
  {
    throw std::invalid_argument("image: is " + described(image.size(), image.type()) + ", expected " +
                                described(t.size, t.type) + " as the template's image");
  }

  result_ = TrackResult();
  result_.status = TrackResult::Status::OUT_OF_IMAGE;
  const cv::Rect whole(cv::Point(), image.size());
  const cv::Rect at_start = t.region + cv::Point(cvRound(start[0]), cvRound(start[1]));
  const cv::Rect part = grown(at_start, cvCeil(options_.range) + kMargin) & whole;
  if (part.width >= 2 * kBins.front() && part.height >= 2 * kBins.front())
  {
    const cv::Mat values = sharpPart(image, part, intensity_);
    const auto dissimilarity = cv::makePtr<Dissimilarity>(options_, t.region);
    BinnedImage seen;
    Motion motion = start;
    for (std::size_t level = 0; level < kBins.size(); ++level)
    {
      seen = binned(values, part.tl(), kBins[level]);
      const BinnedImage scaled = inHistogramBins(seen, options_.bins);
      dissimilarity->setLevel(t.references[level], scaled);
      if (level == 0)
      {
        motion = bestOnGrid(*dissimilarity, start, options_.range, kBins[level]);
      }
      motion = descend(dissimilarity, motion, kBins[level]);
    }
    result_.iterations = dissimilarity->evaluations();
    judge(seen, motion, whole);
    if (result_.found())
    {
      last_good_ = motion;
    }
  }
  lost_ = !result_.found();
  return result_;
}

void TemplateRegistration::judge(const BinnedImage& image, const Eigen::Vector3d& motion, const cv::Rect& whole)
{
  const Template& t = *template_;
  const Eigen::Vector2d centre = centreOf(t.region);
  cv::Mat moved;
  sampleMoved(t.fine, centre, motion, image, moved);
  result_.displacement = motion.head<2>();
  result_.linear = Eigen::Rotation2Dd(motion[2]).toRotationMatrix();
  const Agreement agreement = agreementOf(t.fine.values, moved);
  result_.covariance = covarianceOf(t.fine, agreement, options_.model, centre, motion);
  result_.correlation = agreement.correlation;
  const cv::Rect found = t.region + cv::Point(cvRound(motion[0]), cvRound(motion[1]));
  const double inside = static_cast<double>((found & whole).area()) / t.region.area();
  result_.quality = std::max(0.0, result_.correlation) * agreement.share * inside;
  if (inside < 1.0 - kMaxOutside)
  {
    result_.status = TrackResult::Status::OUT_OF_IMAGE;
  }
  else if (!(result_.correlation >= (lost_ ? options_.found_correlation : options_.min_correlation)) ||
           agreement.share * inside < kLeastSeen)
  {
    result_.status = TrackResult::Status::LOW_CORRELATION;
  }
  else
  {
    result_.status =
        agreement.share * inside < kMostlySeen ? TrackResult::Status::DEGRADED : TrackResult::Status::TRACKED;
  }
}
}  // namespace xray_tracking
