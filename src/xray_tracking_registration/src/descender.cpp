#include "descender.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <utility>

#include <tbb/parallel_for.h>

#include "belief.h"
#include "derivative_free.h"
#include "message.h"
#include "reliability.h"
#include "shifted_views.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr double kAside = 3.0;  // where less alike is asked for: twice what a believed result is off by [mm]
constexpr double kShift = 8.0;  // what Path::SHIFT looks for, at most [mm]
constexpr Resolution kMedium{ 1.1, 3.5 };
constexpr Resolution kShifted{ 2.2, 3.5, kShift };
constexpr Resolution kFineWide{ 1.1, 11.0 };  // for similarities that live on the large structures too
constexpr Descent kTogether{ 12, 3e-3 };
constexpr Descent kApart{ 8, 3e-3 };
constexpr Descent kFinish{ 15, 1e-4 };
/// Where the rest is sought around where the request puts it, and from how many of these places it is followed.
constexpr double kRestTurned = 4.0 * M_PI / 180.0;
constexpr double kRestShifted = 5.0;  // [mm]
constexpr int kRestTries = 4;
constexpr Descent kPart{ 8, 1e-3 };  // to see whether one body would rather be two

/// How far the rest may have moved against the target since the start: weak, a standard deviation of 4 degrees and 5
/// mm.
const Twist kRestInformation =
    (Twist() << Eigen::Vector3d::Constant(205.0), Eigen::Vector3d::Constant(0.04)).finished();
/// The same since the last exposure, whose pose is verified: a degree and 1.25 mm. What is seen of the rest in a trunk
/// outweighs it (thorax_01 and thorax_02 do not change by it); seen at its edge alone, as in knee_real on which it was
/// chosen, the rest goes to and fro by millimetres without it.
const Twist kRestFollowed = 16.0 * kRestInformation;
/// Half a neck's vertebra [mm].
constexpr double kSamePlace = 9.0;
/// A view that is less alike does not show what the others do, however alike these are: an image of another exposure
/// was believed for two views that agreed. Right results that are believed have 0.2 and more (random subjects), 0.36 on
/// real images.
constexpr double kShown = 0.1;
/// Wrong results of one body, where the rest had moved by 14 mm, reach 0.62 and look right otherwise (phantom, C3 to
/// C5).
constexpr double kOneBody = 0.7;
/// What two bodies may differ by from one body that is believed [mm].
constexpr double kMaxParted = 0.8;
}  // namespace

bool nearVerifiedStart(const Run& run, const RigidTransform& room_from_patient)
{
  return run.request.start_verified && run.control.distance(room_from_patient) < kSamePlace;
}

void doubtFor(std::string reason, Outcome& outcome)
{
  outcome.doubt = std::move(reason);
  outcome.probability = std::min(outcome.probability, 0.5);
}

Descender::Descender(const Bodies& bodies, const Eigen::AlignedBox3d& target_box, double voxel_edge,
                     const RegistrationOptions& options)
  : bodies_(bodies),
    box_(target_box),
    voxel_edge_(voxel_edge),
    options_(options),
    similarity_(makeSimilarity(options.similarity)),
    moving_(bodies.one ? Moving::TOGETHER : Moving::BOTH)
{
}

std::vector<ViewLevel> Descender::makeViews(const Run& run, const PosePair& poses, const Resolution& resolution) const
{
  const std::vector<PlacedEnds> ends{ { bodies_.target_ends, poses.target }, { bodies_.rest_ends, poses.rest } };
  std::vector<std::optional<ViewLevel>> made(run.attenuation.size());
  std::vector<std::exception_ptr> errors(made.size());
  tbb::parallel_for(std::size_t{ 0 }, made.size(),
                    [&](std::size_t v)
                    {
                      try
                      {
                        const RegistrationView& view = run.request.views[v];
                        const double magnification = view.geometry.magnification(poses.target * bodies_.centre);
                        const Resolution able{ magnification * std::max(resolution.bin_mm, 0.5 * voxel_edge_),
                                               magnification * std::max(resolution.highpass_mm, voxel_edge_),
                                               magnification * resolution.around_mm };
                        made[v].emplace(view.geometry, run.attenuation[v], view.usable, region(view, poses.target),
                                        able, ends);
                      }
                      catch (...)
                      {
                        errors[v] = std::current_exception();
                      }
                    });
  std::vector<ViewLevel> views;
  for (std::size_t v = 0; v < made.size(); ++v)
  {
    if (errors[v])
    {
      std::rethrow_exception(errors[v]);  // of several the first view's, however they were looked at
    }
    views.push_back(std::move(*made[v]));
  }
  return views;
}

cv::Rect Descender::region(const RegistrationView& view, const RigidTransform& room_from_patient) const
{
  Eigen::AlignedBox2d seen;
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Vector2d pixel =
        view.geometry.project(room_from_patient * box_.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner)));
    // Far outside also if the start is behind the source or as far off as to overflow pixel numbers.
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6))
    {
      throw std::invalid_argument("view " + view.geometry.name() + ": does not see the target from the start pose");
    }
    seen.extend(pixel);
  }
  if (!view.region.empty())
  {
    return view.region;
  }
  const Eigen::Vector2i first = seen.min().array().floor().cast<int>();
  const Eigen::Vector2i end = seen.max().array().ceil().cast<int>() + 1;
  return cv::Rect(first.x(), first.y(), end.x() - first.x(), end.y() - first.y());
}

RestPrior Descender::priorOf(const Run& run)
{
  return { run.request.target_from_rest, run.request.start_verified ? kRestFollowed : kRestInformation };
}

FineLevel Descender::fineLevel(const Run& run, const PosePair& poses) const
{
  FineLevel fine{ makeViews(run, poses, kFine), {} };
  fine.at = linearise(fine.views, bodies_, poses, moving_);
  return fine;
}

Outcome Descender::descend(const Run& run, const PosePair& start, Path path) const
{
  PosePair poses = start;
  try
  {
    run.control.level = 0;
    if (options_.optimiser == Optimiser::GAUSS_NEWTON)
    {
      follow(run, path, poses);
    }
    else
    {
      descendDerivativeFree(run, poses);
    }
    return descend(run, poses, fineLevel(run, poses));
  }
  catch (const std::invalid_argument& error)
  {
    Outcome outcome;
    outcome.poses = poses;
    outcome.doubt = error.what();
    return outcome;
  }
}

Outcome Descender::descend(const Run& run, const PosePair& start, FineLevel fine) const
{
  Outcome outcome;
  outcome.poses = start;
  try
  {
    run.control.level = 1;
    if (options_.optimiser == Optimiser::GAUSS_NEWTON)
    {
      fine.at = gaussNewton(fine.views, bodies_, moving_, priorOf(run), kFinish, std::move(fine.at), run.control,
                            outcome.poses);
    }
    judge(run, fine, outcome);
  }
  catch (const std::invalid_argument& error)
  {
    outcome.doubt = error.what();
  }
  return outcome;
}

void Descender::follow(const Run& run, Path path, PosePair& poses) const
{
  const auto iterate = [&](const std::vector<ViewLevel>& views, Moving moving, const Descent& descent)
  {
    gaussNewton(views, bodies_, moving, priorOf(run), descent, linearise(views, bodies_, poses, moving), run.control,
                poses);
  };
  if (path == Path::SHIFT)
  {
    if (run.control.mayRender(poses.target, 0.0))
    {
      const Eigen::Vector3d shift = mostAlikeShift(bodies_, makeViews(run, poses, kShifted), poses,
                                                   std::min(kShift, run.request.max_translation_mm));
      PosePair shifted =
          moved(poses, (Twist() << Eigen::Vector3d::Zero(), shift).finished(), bodies_.centre, together());
      poses = run.control.inBounds(shifted.target) ? shifted : poses;
    }
  }
  else if (path == Path::MEDIUM)
  {
    iterate(makeViews(run, poses, kMedium), moving_, kApart);
  }
  else
  {
    const std::vector<ViewLevel> coarse = makeViews(run, poses, kCoarse);
    if (moving_ == Moving::BOTH)
    {
      // As one body first: half as many unknowns reach further.
      iterate(coarse, Moving::TOGETHER, kTogether);
    }
    iterate(coarse, moving_, kApart);
    if (moving_ == Moving::BOTH)
    {
      // The coarse level leaves the rest farther off than the finest one reaches.
      iterate(makeViews(run, poses, kMedium), moving_, kApart);
    }
  }
}

void Descender::seekRest(const Run& run, Outcome& outcome) const
{
  if (moving_ != Moving::BOTH || outcome.views.empty() || outcome.rest_sought)
  {
    return;
  }
  outcome.rest_sought = true;
  try
  {
    const std::vector<ViewLevel> views = makeViews(run, outcome.poses, kMedium);
    const auto similarityAt = [&](const PosePair& poses)
    {
      const std::vector<double> all = similarities(views, bodies_, poses);
      return std::accumulate(all.begin(), all.end(), 0.0) / static_cast<double>(all.size());
    };
    PosePair as_requested = outcome.poses;
    as_requested.rest = outcome.poses.target * run.request.target_from_rest;
    std::vector<std::pair<double, PosePair>> tries;
    for (int n = 0; n < 13; ++n)
    {
      Eigen::VectorXd twists = Eigen::VectorXd::Zero(12);
      if (n < 12)
      {
        twists[6 + n / 2] = (n % 2 == 0 ? 1.0 : -1.0) * (n / 2 < 3 ? kRestTurned : kRestShifted);
      }
      const PosePair there = moved(as_requested, twists, bodies_.centre, Moving::BOTH);
      if (!run.control.mayRender(outcome.poses.target, outcome.similarity))
      {
        return;
      }
      tries.emplace_back(similarityAt(there), there);
    }
    std::sort(tries.begin(), tries.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
    tries.resize(kRestTries);
    double most = similarityAt(outcome.poses);
    const PosePair* best = nullptr;
    for (auto& [similarity, poses] : tries)
    {
      similarity = gaussNewton(views, bodies_, moving_, priorOf(run), kApart, linearise(views, bodies_, poses, moving_),
                               run.control, poses)
                       .meanSimilarity();
      if (similarity > most)
      {
        most = similarity;
        best = &poses;
      }
    }
    if (best != nullptr)
    {
      Outcome better = descend(run, *best, fineLevel(run, *best));
      if (better.similarity > outcome.similarity)
      {
        outcome = std::move(better);
        outcome.rest_sought = true;
      }
    }
  }
  catch (const std::invalid_argument&)
  {
    // There is nothing to compare: it stays where it is.
  }
}

void Descender::descendDerivativeFree(const Run& run, PosePair& poses) const
{
  run.control.level = 0;
  optimiseDerivativeFree(makeViews(run, poses, kCoarse), bodies_, together(), *similarity_, 3.0, run.control, poses);
  run.control.level = 1;
  optimiseDerivativeFree(makeViews(run, poses, kFineWide), bodies_, moving_, *similarity_, 0.7, run.control, poses);
}

double Descender::lossAside(const FineLevel& fine, const Eigen::Matrix<double, 6, 6>& tiles,
                            const Outcome& outcome) const
{
  if (!tiles.allFinite() || !(outcome.similarity > 0.0))
  {
    return 0.0;
  }
  const PosePair& poses = outcome.poses;
  const Twist aside = kAside * leastKnown(tiles, poses.target, box_);
  const std::array<RigidTransform, 2> places{ moved(poses, aside, bodies_.centre, Moving::TARGET).target,
                                              moved(poses, -aside, bodies_.centre, Moving::TARGET).target };
  std::vector<std::array<double, 2>> there(fine.views.size());
  tbb::parallel_for(std::size_t{ 0 }, 2 * there.size(),
                    [&](std::size_t n)
                    {
                      const std::size_t v = n / 2;
                      there[v][n % 2] = fine.views[v].similarityAside(bodies_, places[n % 2], fine.at.models[v],
                                                                      poses.saturationOf(v));
                    });
  std::array<double, 2> sums{};
  for (const std::array<double, 2>& view : there)
  {
    sums[0] += view[0];
    sums[1] += view[1];
  }
  return 1.0 - std::max(sums[0], sums[1]) / (static_cast<double>(there.size()) * outcome.similarity);
}

void Descender::judge(const Run& run, const FineLevel& fine, Outcome& outcome) const
{
  const RestPrior prior = priorOf(run);
  const PosePair& poses = outcome.poses;
  outcome.similarity = fine.at.meanSimilarity();
  outcome.views = viewResiduals(fine.views, fine.at, poses.target * bodies_.centre);
  const PoseSpread spread = poseSpread(fine.views, fine.at, prior, poses, bodies_);
  outcome.covariance = spread.covariance;
  std::vector<double> coarse(fine.views.size());
  if (!run.request.start_verified)
  {
    coarse = similarities(makeViews(run, poses, kCoarse), bodies_, poses);
  }
  BeliefFigures& figures = outcome.figures;
  figures.least_similarity = figures.least_coarse_similarity = 1.0;
  for (std::size_t v = 0; v < outcome.views.size(); ++v)
  {
    ViewResidual& view = outcome.views[v];
    view.coarse_similarity = coarse[v];
    view.saturation = poses.saturationOf(v);
    figures.least_similarity = std::min(figures.least_similarity, view.similarity);
    figures.least_coarse_similarity = std::min(figures.least_coarse_similarity, view.coarse_similarity);
    figures.pull_mm = std::max(figures.pull_mm, view.pull_mm);
  }
  figures.expected_error_mm = expectedError(spread.tiles, poses.target, box_);
  const Distinctness distinctness = distinctnessOf(fine, poses.target * bodies_.centre);
  figures.here = distinctness.here;
  figures.rival = distinctness.rival;
  figures.distinctness = distinctness.z;
  figures.loss_aside = lossAside(fine, spread.tiles, outcome);
  outcome.probability = probabilityOf(figures, nearVerifiedStart(run, poses.target));
  const bool known = outcome.covariance.allFinite() &&
                     std::all_of(outcome.views.begin(), outcome.views.end(),
                                 [](const ViewResidual& view)
                                 { return std::isfinite(view.similarity + view.coarse_similarity + view.pull_mm); });
  if (!known)
  {
    outcome.probability = 0.0;
    outcome.doubt = "its figures are not finite";
  }
  else if (outcome.probability < options_.min_probability)
  {
    outcome.doubt = message("probability is ", outcome.probability, ", below ", options_.min_probability,
                            "; what speaks against it most is the ", mostDoubtful(figures));
  }
  else if (figures.least_similarity < kShown)
  {
    doubtFor(message("a view's similarity is ", figures.least_similarity, ", below ", kShown,
                     ": it does not show what the others do"),
             outcome);
  }
  else if (bodies_.surrounded && figures.least_similarity < kOneBody)
  {
    doubtFor(message("similarity is ", figures.least_similarity, ", below the ", kOneBody,
                     " that is asked for where the rest of the body is taken to move as the target"),
             outcome);
  }
  else if (bodies_.one)
  {
    PosePair apart = poses;
    gaussNewton(fine.views, bodies_, Moving::BOTH, prior, kPart, linearise(fine.views, bodies_, apart, Moving::BOTH),
                run.control, apart);
    const double parted = targetRegistrationError(apart.target, poses.target, box_);
    if (parted > kMaxParted)
    {
      doubtFor(message("two bodies would have the target ", parted, " mm elsewhere, above ", kMaxParted), outcome);
    }
  }
}
}  // namespace xray_tracking
