#include "image_level.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_registration/attenuation_image.h"

namespace xray_tracking
{
namespace
{
Eigen::VectorXf flattened(const cv::Mat& image)
{
  Eigen::VectorXf values(image.total());
  for (int row = 0; row < image.rows; ++row)
  {
    values.segment(row * image.cols, image.cols) = Eigen::Map<const Eigen::VectorXf>(image.ptr<float>(row), image.cols);
  }
  return values;
}

Eigen::Map<Eigen::ArrayXf> mapped(cv::Mat& mat)
{
  return { mat.ptr<float>(), static_cast<Eigen::Index>(mat.total()) };
}

/// Below, the closed forms lose their digits in single precision; the attenuation is then straight to 1 or 2 %.
float withDigits(double saturation)
{
  return std::max(static_cast<float>(saturation), 0.01f);
}

/// Line integrals L become (1 - exp(-k L)) / k.
void saturate(double saturation, cv::Mat& image)
{
  const float k = withDigits(saturation);
  auto values = mapped(image);
  values = (1.0f - (-k * values).exp()) / k;
}

/// As above. @param slope out, derivative by L; @param by_saturation out, by k
void saturate(double saturation, cv::Mat& image, cv::Mat& slope, cv::Mat& by_saturation)
{
  slope.create(image.size(), CV_32FC1);
  by_saturation.create(image.size(), CV_32FC1);
  const float k = withDigits(saturation);
  auto values = mapped(image);
  auto slopes = mapped(slope);
  slopes = (-k * values).exp();
  const Eigen::ArrayXf saturated = (1.0f - slopes) / k;
  mapped(by_saturation) = (values * slopes - saturated) / k;
  values = saturated;
}

constexpr double kUsableShare = 0.75;  // of a bin's pixels
constexpr int kImage = kPixelRow - 1;  // which of a pixel's numbers the image is while it is high-passed
constexpr int kSample = 1000;          // pixels, at least, where there are as many
constexpr double kMinGain = 0.05;      // of a model that is not yet like the image

// What the rest may move by and be followed to first order [mm], and how far what is compared is from the target's
// centre, about [mm]: well below what is seen of it, voxels of 2 mm.
constexpr double kFollowed = 0.4;
constexpr double kReach = 50.0;
}  // namespace

bool RestRendering::reaches(const RigidTransform& other_room_from_rest) const
{
  if (line_integrals.empty())
  {
    return false;
  }
  const Twist twist = twistAbout(room_centre, other_room_from_rest * room_from_rest.inverse());
  return twist.tail<3>().norm() + kReach * twist.head<3>().norm() < kFollowed;
}

cv::Mat RestRendering::at(const RigidTransform& other_room_from_rest) const
{
  using Derivatives = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 6, Eigen::RowMajor>>;
  const Twist twist = twistAbout(room_centre, other_room_from_rest * room_from_rest.inverse());
  cv::Mat there = line_integrals.clone();
  const auto count = static_cast<Eigen::Index>(there.total());
  Eigen::Map<Eigen::VectorXf>(there.ptr<float>(), count) +=
      Derivatives(derivatives.ptr<float>(), count, 6) * twist.cast<float>();
  return there;
}

HighPass::HighPass(const RunningBlur& blur, const cv::Mat& counts, int border)
  : blur_(blur), counts_(counts), inner_(border, border, counts.cols - 2 * border, counts.rows - 2 * border)
{
  cv::Mat share = counts.clone();
  blur_(share);
  counted_inverse_ = counts_ / cv::max(share, 1e-3);
}

cv::Mat HighPass::operator()(const cv::Mat& image) const
{
  const cv::Mat counted = image.mul(counts_);
  cv::Mat means = counted.clone();
  blur_(means);
  return (counted - means.mul(counted_inverse_))(inner_);
}

PixelRows HighPass::operator()(const PixelRows& rows) const
{
  return blur_.withoutMeans(rows, counts_.size(), counted_inverse_, inner_);
}

ViewLevel::ViewLevel(const ProjectionGeometry& geometry, const AttenuationImage& attenuation, const cv::Mat& usable,
                     const cv::Rect& region, const Resolution& resolution, const std::vector<PlacedEnds>& ends)
  : geometry_(&geometry), blur_(1.0)
{
  const double pitch = geometry.pixelPitch().mean();
  const int bin = std::max(1, static_cast<int>(std::lround(resolution.bin_mm / pitch)));
  const double sigma = resolution.highpass_mm / (bin * pitch);
  blur_ = RunningBlur(sigma);
  // Beyond a few bins the border only has to tell the local mean roughly.
  border_ = static_cast<int>(std::ceil(std::min(sigma, 4.0))) + 1;
  const cv::Rect bins(0, 0, attenuation.size().width / bin, attenuation.size().height / bin);
  const cv::Point first(static_cast<int>(std::floor(double(region.x) / bin)) - border_,
                        static_cast<int>(std::floor(double(region.y) / bin)) - border_);
  const cv::Point end(static_cast<int>(std::ceil(double(region.x + region.width) / bin)) + border_,
                      static_cast<int>(std::ceil(double(region.y + region.height) / bin)) + border_);
  const cv::Rect bordered = cv::Rect(first, end) & bins;
  size_ = bordered.size() - cv::Size(2 * border_, 2 * border_);
  if (size_.width < kMinEdge || size_.height < kMinEdge)
  {
    throw std::invalid_argument("view " + geometry.name() + ": the region to compare has " +
                                std::to_string(region.width) + " x " + std::to_string(region.height) +
                                " pixels, too few of them in the image: expected at least " +
                                std::to_string(kMinEdge * bin) + " along either edge and some border");
  }
  const cv::Rect pixels(bordered.x * bin, bordered.y * bin, bordered.width * bin, bordered.height * bin);
  grid_ = PixelGrid::binnedRegion({ pixels.x, pixels.y }, { pixels.width, pixels.height }, bin);
  const auto around = static_cast<int>(std::ceil(resolution.around_mm / (bin * pitch)));
  const cv::Rect wide =
      cv::Rect(bordered.tl() - cv::Point(around, around), bordered.size() + cv::Size(2 * around, 2 * around)) & bins;
  laid_out_ = attenuation.bins(wide, bin, usable);
  grid_in_it_ = bordered.tl() - wide.tl();
  const cv::Rect own(grid_in_it_, bordered.size());
  leaveOut(laid_out_.share.empty() ? cv::Mat() : laid_out_.share(own), ends);
  measured_image_ = high_pass_(laid_out_.mean(own)).clone();
  measured_ = flattened(measured_image_);
  if (normalise(measured_) == 0.0f)
  {
    throw std::invalid_argument("view " + geometry.name() + ": the image is constant in the region to compare");
  }
}

void ViewLevel::leaveOut(const cv::Mat& usable, const std::vector<PlacedEnds>& ends)
{
  constexpr double kLeastShare = 0.5;
  cv::Mat inside = insideEnds(*geometry_, grid_, ends);
  if (!ends.empty())
  {
    // The pose is not the final one, and a bin's other rays are to be inside too.
    cv::erode(inside, inside, cv::Mat(), cv::Point(-1, -1), 2, cv::BORDER_REFLECT);
  }
  const cv::Rect without_border(border_, border_, size_.width, size_.height);
  const double in_ct = cv::mean(inside(without_border))[0];
  if (!usable.empty())
  {
    inside.setTo(0.0f, usable < kUsableShare);
  }
  const double left = cv::mean(inside(without_border))[0];
  if (left < kLeastShare)
  {
    const std::string why = in_ct < kLeastShare ? "the CT ends inside the region to compare, "
                                                : "much of the region to compare is not usable (borders, defects), ";
    throw std::invalid_argument("view " + geometry_->name() + ": " + why +
                                std::to_string(static_cast<int>(100.0 * left)) + " % of it are left: expected " +
                                std::to_string(static_cast<int>(100.0 * kLeastShare)) + " % or more");
  }
  valid_ = flattened(inside(without_border));
  const auto step = std::max(1, static_cast<int>((valid_.array() > 0.0f).count()) / kSample);
  int counted = 0;
  for (int n = 0; n < static_cast<int>(valid_.size()); ++n)
  {
    if (valid_[n] > 0.0f && counted++ % step == 0)
    {
      sample_.push_back(n);
    }
  }
  high_pass_ = HighPass(blur_, inside, border_);
}

Surroundings ViewLevel::surroundings() const
{
  cv::Mat counts(laid_out_.mean.size(), CV_32FC1, cv::Scalar(1.0));
  if (!laid_out_.share.empty())
  {
    counts.setTo(0.0f, laid_out_.share < kUsableShare);
  }
  const cv::Size inner = counts.size() - cv::Size(2 * border_, 2 * border_);
  return { HighPass(blur_, counts, border_)(laid_out_.mean),
           laid_out_.share.empty() ? cv::Mat() : counts(cv::Rect(cv::Point(border_, border_), inner)), grid_in_it_ };
}

float ViewLevel::normalise(Eigen::VectorXf& image) const
{
  const float mean = image.dot(valid_) / valid_.sum();
  image = (image.array() - mean) * valid_.array();
  const float norm = image.norm();
  if (!(norm > 1e-6f * std::sqrt(static_cast<float>(image.size()))))
  {
    image.setZero();
    return 0.0f;
  }
  image /= norm;
  return norm;
}

void ViewLevel::modelImage(const Bodies& bodies, const PosePair& poses, double saturation, cv::Mat& image) const
{
  cv::Mat rest;
  bodies.rest->render(*geometry_, grid_, poses.rest, poses.target * bodies.centre, rest);
  modelImage(bodies, poses.target, rest, saturation, image);
}

void ViewLevel::modelImage(const Bodies& bodies, const RigidTransform& room_from_target, const cv::Mat& rest,
                           double saturation, cv::Mat& image) const
{
  bodies.target->render(*geometry_, grid_, room_from_target, room_from_target * bodies.centre, image);
  image += rest;
  saturate(saturation, image);
  image = high_pass_(image);
}

double ViewLevel::similarity(const Bodies& bodies, const PosePair& poses, double saturation) const
{
  cv::Mat image;
  modelImage(bodies, poses, saturation, image);
  return similarityTo(image);
}

double ViewLevel::similarityAside(const Bodies& bodies, const RigidTransform& room_from_target, const ViewModel& model,
                                  double saturation) const
{
  cv::Mat image;
  modelImage(bodies, room_from_target, model.rest, saturation, image);
  return similarityTo(image);
}

double ViewLevel::similarityTo(const cv::Mat& image) const
{
  Eigen::VectorXf model = flattened(image);
  normalise(model);
  return measured_.dot(model);
}

void ViewLevel::model(const Bodies& bodies, const PosePair& poses, double saturation, Moving moving,
                      ViewModel& model) const
{
  cv::Mat image;
  std::array<cv::Mat, 2> derivatives;
  const Eigen::Vector3d centre = poses.target * bodies.centre;
  bodies.target->renderWithDerivatives(*geometry_, grid_, poses.target, centre, image, derivatives[0]);
  if (moving == Moving::TARGET)
  {
    model.rest = cv::Mat();
    bodies.rest->render(*geometry_, grid_, poses.rest, centre, model.rest);
  }
  else
  {
    RestRendering& rendered = model.rendered;
    if (!rendered.reaches(poses.rest))
    {
      rendered = { {}, {}, poses.rest, centre };
      bodies.rest->renderWithDerivatives(*geometry_, grid_, poses.rest, centre, rendered.line_integrals,
                                         rendered.derivatives);
    }
    model.rest = rendered.at(poses.rest);
    derivatives[1] = rendered.derivatives;
  }
  image += model.rest;
  if (moving == Moving::TOGETHER)
  {
    derivatives[0] += derivatives[1];
  }
  cv::Mat slope;
  cv::Mat by_saturation;
  saturate(saturation, image, slope, by_saturation);
  model.twists = moving == Moving::BOTH ? 12 : 6;
  const PixelRows rows =
      makeRows({ derivatives[0].ptr<float>(), moving == Moving::BOTH ? derivatives[1].ptr<float>() : nullptr,
                 by_saturation.ptr<float>(), image.ptr<float>(), slope.ptr<float>(), high_pass_.counts().ptr<float>() },
               static_cast<int>(image.total()));
  model.derivatives = high_pass_(rows);
  model.image = model.derivatives.col(kImage);
  model.derivatives.col(kImage).setZero();
  const float norm = normalise(model.image);
  model.similarity = measured_.dot(model.image);
  if (norm == 0.0f)
  {
    model.derivatives.setZero();
    return;
  }
  const auto gain = static_cast<float>(std::max(model.similarity, kMinGain));
  projectOut(model.image, valid_, gain / norm, model.derivatives);
  model.image *= gain;
}

void ViewLevel::move(const Eigen::VectorXf& step, ViewModel& model) const
{
  const float norm_before = model.image.norm();
  const double similarity_before = std::max(model.similarity, kMinGain);
  Eigen::VectorXf steps = Eigen::VectorXf::Zero(kPixelRow);
  steps.head(step.size()) = step;
  model.image += model.derivatives.matrix() * steps;
  if (normalise(model.image) == 0.0f)
  {
    return;
  }
  model.similarity = measured_.dot(model.image);
  // As much of the measured image as before, by what is more alike.
  model.image *= norm_before * static_cast<float>(std::max(model.similarity, kMinGain) / similarity_before);
}
}  // namespace xray_tracking
