#include "pose_search.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <tbb/parallel_for.h>
#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
// Steps of the translations, and what a rotation by one of the lattice's edges moves the target's box by, root mean
// square, in such steps: so that from the nearest point there is less to go than descents are able to. Chosen on
// wrist_real, the set with the smallest capture range, and found to be enough on the others.
constexpr double kStepShare = 0.1;  // of the target's size
constexpr double kMinStep = 1.5;    // [mm]
constexpr double kMaxStep = 4.0;
constexpr double kRotationSteps = 1.7;
constexpr double kMinRotationStep = 6.0 * M_PI / 180.0;
constexpr double kMaxRotationStep = 14.0 * M_PI / 180.0;
constexpr double kAround = 4.0;       // standard deviation of what a gradient is compared with [bins]
constexpr double kLeastEnergy = 0.1;  // of the mean: where there is nothing, noise is not to be made an edge of
constexpr double kAllUsable = 0.998;  // of a bin, but for rounding
constexpr float kLeastSeen = 0.5f;    // of the target in every view
constexpr double kMostBins = 1e6;     // of a view: a hundred times as many as usual
constexpr std::size_t kPeaksEach = 16;
constexpr std::size_t kBatch = 8;  // orientations between two questions whether to go on

double sizeOf(const Eigen::AlignedBox3d& box)
{
  return std::sqrt(box.sizes().squaredNorm() / 12.0);
}

/// Points of a body-centred cubic lattice in a sphere: of all lattices it leaves the smallest holes.
std::vector<Eigen::Vector3d> latticePoints(double radius, double edge)
{
  std::vector<Eigen::Vector3d> points;
  const int n = static_cast<int>(radius / edge) + 1;
  for (int i = -n; i <= n; ++i)
  {
    for (int j = -n; j <= n; ++j)
    {
      for (int k = -n; k <= n; ++k)
      {
        for (const double half : { 0.0, 0.5 })
        {
          const Eigen::Vector3d point = edge * (Eigen::Vector3d(i, j, k).array() + half);
          if (point.norm() <= radius)
          {
            points.push_back(point);
          }
        }
      }
    }
  }
  return points;
}

/// Gradients over the root mean square of those around, CV_32FC2; 0 where they do not count.
/// @param valid of the gradients, out: 1 where all that makes them up is usable
cv::Mat normalisedGradients(const cv::Mat& image, const cv::Mat& usable, double sigma, cv::Mat& valid)
{
  cv::erode(usable, valid, cv::Mat(), cv::Point(-1, -1), 1, cv::BORDER_REFLECT);
  cv::Mat along[2];
  cv::Sobel(image, along[0], CV_32F, 1, 0, 3, 1.0, 0.0, cv::BORDER_REFLECT);
  cv::Sobel(image, along[1], CV_32F, 0, 1, 3, 1.0, 0.0, cv::BORDER_REFLECT);
  along[0] = along[0].mul(valid);
  along[1] = along[1].mul(valid);
  const cv::Mat energy = along[0].mul(along[0]) + along[1].mul(along[1]);
  cv::Mat around;
  cv::Mat share;
  cv::GaussianBlur(energy, around, cv::Size(), sigma, sigma, cv::BORDER_REFLECT);
  cv::GaussianBlur(valid, share, cv::Size(), sigma, sigma, cv::BORDER_REFLECT);
  cv::max(share, 1e-3, share);
  around = around.mul(1.0 / share);
  const double counting = std::max(1.0, cv::sum(valid)[0]);
  around += kLeastEnergy * cv::sum(energy)[0] / counting + 1e-12;
  cv::sqrt(around, around);
  along[0] /= around;
  along[1] /= around;
  cv::Mat gradients;
  cv::merge(along, 2, gradients);
  return gradients;
}

cv::Mat squaredNorms(const cv::Mat& gradients)
{
  cv::Mat along[2];
  cv::split(gradients, along);
  return along[0].mul(along[0]) + along[1].mul(along[1]);
}

float interpolated(const cv::Mat& surface, const cv::Point2f& at)
{
  const int x = static_cast<int>(at.x);
  const int y = static_cast<int>(at.y);
  const float right = at.x - static_cast<float>(x);
  const float down = at.y - static_cast<float>(y);
  const float* upper = surface.ptr<float>(y) + x;
  const float* lower = surface.ptr<float>(y + 1) + x;
  return (1.0f - down) * ((1.0f - right) * upper[0] + right * upper[1]) +
         down * ((1.0f - right) * lower[0] + right * lower[1]);
}
}  // namespace

PoseSearch::PoseSearch(const Run& run, const Bodies& bodies, const Eigen::AlignedBox3d& target_box,
                       const PosePair& start, const SearchBounds& bounds, Moving together)
  : run_(run),
    bodies_(bodies),
    box_(target_box),
    start_(start),
    together_(together),
    centre_(start.target * bodies.centre),
    step_(std::clamp(kStepShare * sizeOf(target_box), kMinStep, kMaxStep)),
    reach_(static_cast<int>(bounds.translation_mm / step_))
{
  const int edge = 2 * reach_ + 1;
  index_.assign(static_cast<std::size_t>(edge) * edge * edge, -1);
  std::size_t n = 0;
  for (int i = -reach_; i <= reach_; ++i)
  {
    for (int j = -reach_; j <= reach_; ++j)
    {
      for (int k = -reach_; k <= reach_; ++k, ++n)
      {
        const Eigen::Vector3d translation = step_ * Eigen::Vector3d(i, j, k);
        if (translation.norm() <= bounds.translation_mm)
        {
          index_[n] = static_cast<int>(translations_.size());
          translations_.push_back(translation);
        }
      }
    }
  }
  const double rotation_step =
      std::clamp(kRotationSteps * step_ / sizeOf(target_box), kMinRotationStep, kMaxRotationStep);
  rotations_ = latticePoints(bounds.rotation_rad, rotation_step);
  views_.resize(run.attenuation.size());
  tbb::parallel_for(std::size_t{ 0 }, views_.size(),
                    [&](std::size_t v) { views_[v] = makeView(run.request.views[v], run.attenuation[v]); });
}

PoseSearch::View PoseSearch::makeView(const RegistrationView& from, const AttenuationImage& attenuation) const
{
  View view;
  const ProjectionGeometry& geometry = from.geometry;
  view.geometry = &geometry;
  const double pixels = geometry.magnification(centre_) / geometry.pixelPitch().mean();  // a millimetre's
  view.bin = std::max(1, static_cast<int>(std::lround(step_ * pixels)));
  view.sigma = kAround * step_ * pixels / view.bin;
  const auto inBins = [&](const Eigen::Vector3d& point)
  {
    const Eigen::Vector2d pixel = geometry.project(point);
    // Also if it is behind the source.
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6))
    {
      throw std::invalid_argument("view " + geometry.name() + ": does not see all of the neighbourhood to search");
    }
    return Eigen::Vector2d((pixel.array() + 0.5) / view.bin - 0.5);
  };
  const Eigen::Vector2d centre = inBins(centre_);
  view.centre = { centre.x(), centre.y() };
  Eigen::AlignedBox2d seen;
  for (int corner = 0; corner < 8; ++corner)
  {
    seen.extend(inBins(start_.target * box_.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner))));
  }
  Eigen::AlignedBox2d reached;
  for (const Eigen::Vector3d& translation : translations_)
  {
    reached.extend(inBins(centre_ + translation) - centre);
  }
  const Eigen::Vector2i first = seen.min().array().floor().cast<int>();
  const Eigen::Vector2i size = seen.max().array().ceil().cast<int>() + 1 - first.array();
  const Eigen::Vector2i before = (-reached.min()).array().ceil().cast<int>();
  const Eigen::Vector2i behind = reached.max().array().ceil().cast<int>() + 1;
  const int border = static_cast<int>(std::ceil(2.0 * view.sigma)) + 1;
  view.around = cv::Rect(first.x() - border, first.y() - border, size.x() + 2 * border, size.y() + 2 * border);
  view.inside = cv::Rect(border, border, size.x(), size.y());

  // The image, and nothing that counts around it.
  const cv::Rect area(view.around.x - before.x(), view.around.y - before.y(),
                      view.around.width + before.x() + behind.x(), view.around.height + before.y() + behind.y());
  if (static_cast<double>(area.width) * area.height > kMostBins)
  {
    throw std::invalid_argument("view " + geometry.name() +
                                ": the neighbourhood to search comes too near to the source");
  }
  const cv::Rect there =
      area & cv::Rect(0, 0, attenuation.size().width / view.bin, attenuation.size().height / view.bin);
  cv::Mat image(area.size(), CV_32FC1, 0.0f);
  cv::Mat usable(area.size(), CV_32FC1, 0.0f);
  if (!there.empty())
  {
    const cv::Rect inside = there - area.tl();
    const AttenuationBins bins = attenuation.bins(there, view.bin, from.usable);
    // Sobel's neighbours of the outermost bins; they do not count themselves.
    cv::copyMakeBorder(bins.mean, image, inside.y, area.height - inside.y - inside.height, inside.x,
                       area.width - inside.x - inside.width, cv::BORDER_REPLICATE);
    usable(inside).setTo(1.0f, bins.share.empty() ? cv::noArray() : cv::Mat(bins.share > kAllUsable));
  }
  cv::Mat valid;
  const cv::Mat gradients = normalisedGradients(image, usable, view.sigma, valid);
  const cv::Rect core(border, border, area.width - 2 * border, area.height - 2 * border);
  view.searched = area.tl() + core.tl();
  view.image.gradients = gradients(core).clone();
  view.image.valid = valid(core).clone();
  view.image.energy = squaredNorms(view.image.gradients);
  const cv::Mat ones(view.inside.size(), CV_32FC1, 1.0f);
  cv::matchTemplate(view.image.energy, ones, view.image.whole_energy, cv::TM_CCORR);
  cv::matchTemplate(view.image.valid, ones, view.image.whole_valid, cv::TM_CCORR);
  view.projected.reserve(translations_.size());
  for (const Eigen::Vector3d& translation : translations_)
  {
    const Eigen::Vector2d shift = inBins(centre_ + translation) - centre + before.cast<double>();
    view.projected.emplace_back(static_cast<float>(shift.x()), static_cast<float>(shift.y()));
  }
  return view;
}

PoseSearch::Template PoseSearch::render(const View& view, const PosePair& poses, const cv::Point& shift) const
{
  const cv::Rect region = view.around + shift;
  PixelGrid grid;
  grid.first = Eigen::Vector2d(region.x, region.y).array() * view.bin + 0.5 * (view.bin - 1);
  grid.step = Eigen::Vector2d::Constant(view.bin);
  grid.size = Eigen::Vector2i(region.width, region.height);
  const Eigen::Vector3d centre = poses.target * bodies_.centre;
  cv::Mat image;
  cv::Mat rest;
  bodies_.target->render(*view.geometry, grid, poses.target, centre, image);
  bodies_.rest->render(*view.geometry, grid, poses.rest, centre, rest);
  image += rest;
  const cv::Mat inside_ct =
      insideEnds(*view.geometry, grid, { { bodies_.target_ends, poses.target }, { bodies_.rest_ends, poses.rest } });
  Template drr;
  cv::Mat valid;
  drr.gradients = normalisedGradients(image, inside_ct, view.sigma, valid)(view.inside);
  drr.valid = valid(view.inside);
  drr.energy = squaredNorms(drr.gradients);
  drr.complete = cv::countNonZero(drr.valid) == view.inside.area();
  return drr;
}

cv::Mat PoseSearch::correlate(const Searched& image, const Template& drr)
{
  cv::Mat surface;
  cv::matchTemplate(image.gradients, drr.gradients, surface, cv::TM_CCORR);
  cv::Mat energy;
  cv::Mat counting;
  if (drr.complete)
  {
    energy = image.whole_energy;
    counting = image.whole_valid;
  }
  else
  {
    cv::matchTemplate(image.energy, drr.valid, energy, cv::TM_CCORR);
    cv::matchTemplate(image.valid, drr.valid, counting, cv::TM_CCORR);
  }
  cv::Mat own;
  cv::matchTemplate(image.valid, drr.energy, own, cv::TM_CCORR);
  const float least_own = kLeastSeen * static_cast<float>(cv::sum(drr.energy)[0]);
  const float least_counting = kLeastSeen * static_cast<float>(drr.valid.total());
  for (int row = 0; row < surface.rows; ++row)
  {
    for (int column = 0; column < surface.cols; ++column)
    {
      const float product = energy.at<float>(row, column) * own.at<float>(row, column);
      const bool seen = counting.at<float>(row, column) >= least_counting && own.at<float>(row, column) >= least_own &&
                        product > 1e-6f;
      float& value = surface.at<float>(row, column);
      value = seen ? value / std::sqrt(product) : 0.0f;
    }
  }
  return surface;
}

PosePair PoseSearch::pose(const Eigen::Vector3d& rotation, const Eigen::Vector3d& translation) const
{
  Twist twist;
  twist << rotation, translation;
  return moved(start_, twist, bodies_.centre, together_);
}

std::vector<PoseSearch::Peak> PoseSearch::peaks(std::size_t rotation) const
{
  const PosePair poses = pose(rotations_[rotation], Eigen::Vector3d::Zero());
  std::vector<float> similarities(translations_.size(), 0.0f);
  for (const View& view : views_)
  {
    const cv::Mat surface = correlate(view.image, render(view, poses, { 0, 0 }));
    for (std::size_t t = 0; t < translations_.size(); ++t)
    {
      similarities[t] += interpolated(surface, view.projected[t]) / static_cast<float>(views_.size());
    }
  }
  std::vector<Peak> peaks;
  const int edge = 2 * reach_ + 1;
  const auto at = [&](int i, int j, int k) { return index_[(static_cast<std::size_t>(i) * edge + j) * edge + k]; };
  const auto isPeak = [&](int i, int j, int k)
  {
    const float value = similarities[at(i, j, k)];
    for (int a = std::max(0, i - 1); a <= std::min(edge - 1, i + 1); ++a)
    {
      for (int b = std::max(0, j - 1); b <= std::min(edge - 1, j + 1); ++b)
      {
        for (int c = std::max(0, k - 1); c <= std::min(edge - 1, k + 1); ++c)
        {
          const int neighbour = at(a, b, c);
          if (neighbour >= 0 && similarities[neighbour] > value)
          {
            return false;
          }
        }
      }
    }
    return value > 0.0f;
  };
  for (int i = 0; i < edge; ++i)
  {
    for (int j = 0; j < edge; ++j)
    {
      for (int k = 0; k < edge; ++k)
      {
        if (at(i, j, k) >= 0 && isPeak(i, j, k))
        {
          const auto translation = static_cast<std::size_t>(at(i, j, k));
          peaks.push_back({ rotation, translation, similarities[translation] });
        }
      }
    }
  }
  const std::size_t count = std::min(peaks.size(), kPeaksEach);
  std::partial_sort(peaks.begin(), peaks.begin() + count, peaks.end(),
                    [](const Peak& a, const Peak& b) { return a.similarity > b.similarity; });
  peaks.resize(count);
  return peaks;
}

std::vector<Place> PoseSearch::places(std::size_t count) const
{
  std::vector<std::vector<Peak>> found(rotations_.size());
  for (std::size_t first = 0; first < rotations_.size(); first += kBatch)
  {
    if (!run_.control.mayRender(start_.target, 0.0))
    {
      break;
    }
    const std::size_t end = std::min(first + kBatch, rotations_.size());
    run_.control.renderings += static_cast<int>(end - first) - 1;
    tbb::parallel_for(first, end, [&](std::size_t rotation) { found[rotation] = peaks(rotation); });
  }
  if (run_.control.stop() != RunControl::Stop::NONE)
  {
    return {};
  }
  std::vector<Peak> all;
  for (const std::vector<Peak>& peaks : found)
  {
    all.insert(all.end(), peaks.begin(), peaks.end());
  }
  std::stable_sort(all.begin(), all.end(), [](const Peak& a, const Peak& b) { return a.similarity > b.similarity; });
  std::vector<Place> places;
  for (const Peak& peak : all)
  {
    const Place place{ pose(rotations_[peak.rotation], translations_[peak.translation]), peak.similarity };
    const bool apart =
        std::all_of(places.begin(), places.end(),
                    [&](const Place& other)
                    { return targetRegistrationError(place.poses.target, other.poses.target, box_) > separation(); });
    if (apart)
    {
      places.push_back(place);
    }
    if (places.size() == count)
    {
      break;
    }
  }
  return places;
}

double PoseSearch::similarity(const PosePair& poses) const
{
  double sum = 0.0;
  for (const View& view : views_)
  {
    const Eigen::Vector2d pixel = view.geometry->project(poses.target * bodies_.centre);
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6))
    {
      continue;
    }
    const Eigen::Vector2d bins = (pixel.array() + 0.5) / view.bin - 0.5;
    const cv::Point shift(static_cast<int>(std::lround(bins.x() - view.centre.x)),
                          static_cast<int>(std::lround(bins.y() - view.centre.y)));
    const cv::Rect region((view.around + shift).tl() + view.inside.tl() - view.searched, view.inside.size());
    if ((region & cv::Rect(cv::Point(), view.image.gradients.size())) != region)
    {
      continue;  // as far out as the bounds allow: nothing was prepared there
    }
    Searched part{ view.image.gradients(region), view.image.energy(region), view.image.valid(region), {}, {} };
    part.whole_energy = cv::Mat(1, 1, CV_32FC1, cv::sum(part.energy)[0]);
    part.whole_valid = cv::Mat(1, 1, CV_32FC1, cv::sum(part.valid)[0]);
    sum += correlate(part, render(view, poses, shift)).at<float>(0, 0);
  }
  return sum / static_cast<double>(views_.size());
}

double PoseSearch::separation() const
{
  return 1.6 * step_;
}
}  // namespace xray_tracking
