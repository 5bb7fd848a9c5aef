#include "xray_tracking_registration/registration.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>

#include <Eigen/Eigenvalues>

#include "xray_tracking_core/volume/resampling.h"

#include "derivative_free.h"
#include "gauss_newton.h"
#include "image_level.h"
#include "reliability.h"
#include "run_control.h"
#include "xray_tracking_registration/attenuation_image.h"
#include "xray_tracking_registration/similarity.h"

namespace xray_tracking
{
namespace
{
constexpr Resolution kCoarse{ 3.2, 16.0 };
constexpr Resolution kFine{ 1.6, 1.6 };
constexpr double kUsualMagnification = 1.45;  // of a treatment room's detectors; only how smooth DRRs are hangs on it
constexpr Resolution kFineWide{ 1.6, 16.0 };  // for similarities that live on the large structures too
constexpr Descent kTogether{ 12, 3e-3 };
constexpr Descent kApart{ 8, 3e-3 };
constexpr Descent kFinish{ 15, 1e-4 };
constexpr Descent kTry{ 6, 1e-2 };

// Where to start again if the first try fails: this far from the start along and about each axis of the room.
constexpr double kRetryTranslation = 7.0;  // [mm]
constexpr double kRetryRotation = 4.0 * M_PI / 180.0;
constexpr std::size_t kRetries = 3;  // that are followed to the end

/// Where one descent ended.
struct Outcome
{
  PosePair poses;
  std::vector<ViewResidual> views;
  double similarity = -1.0;
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  std::string doubt;  ///< why it is not to be believed; empty if it is
};

template <typename... Parts>
std::string message(const Parts&... parts)
{
  std::ostringstream text;
  text.precision(3);
  (text << ... << parts);
  return text.str();
}

void check(const RegistrationRequest& request)
{
  if (request.views.empty())
  {
    throw std::invalid_argument("views: none, expected one or more");
  }
  for (const RegistrationView& view : request.views)
  {
    const Eigen::Vector2i& size = view.geometry.imageSize();
    if (view.image.cols != size.x() || view.image.rows != size.y())
    {
      throw std::invalid_argument(message("view ", view.geometry.name(), ": the image has ", view.image.cols, " x ",
                                          view.image.rows, " pixels: expected ", size.x(), " x ", size.y()));
    }
  }
  if (!isRigid(request.room_from_patient) || !isRigid(request.target_from_rest))
  {
    throw std::invalid_argument("start pose: expected finite rigid transforms");
  }
  if (!(request.max_translation_mm > 0.0) || !(request.max_rotation_rad > 0.0))
  {
    throw std::invalid_argument(message("bounds are ", request.max_translation_mm, " mm and ", request.max_rotation_rad,
                                        " rad: expected more than 0"));
  }
  if (!(request.time_budget.count() > 0.0))
  {
    throw std::invalid_argument(message("time budget is ", request.time_budget.count(), " s: expected more than 0"));
  }
}
}  // namespace

class Registration::Implementation
{
public:
  Implementation(const BodyModel& bodies, const Eigen::AlignedBox3d& box, const RegistrationOptions& options)
    : options_(options), box_(box), similarity_(makeSimilarity(options.similarity))
  {
    options.validate();
    if (box.isEmpty() || !box.min().allFinite() || !box.max().allFinite())
    {
      throw std::invalid_argument("target box: expected finite corners, min below max");
    }
    if (bodies.target.values.empty())
    {
      throw std::invalid_argument("bodies: the target has no voxel");
    }
    bodies_.centre = box.center();
    voxel_edge_ = std::cbrt(std::abs(bodies.target.grid.patient_from_index.linear().determinant()));
    const double footprint = std::max(kFine.bin_mm / kUsualMagnification, voxel_edge_);
    bodies_.target = std::make_unique<BodyRenderer>(bodies.target, footprint, options.projector);
    if (!bodies.rest.values.empty())
    {
      // A nuisance, and most of the voxels. As it deforms, which the model does not, a smooth one also fits the better.
      bodies_.rest = std::make_unique<BodyRenderer>(halved(bodies.rest), footprint, options.projector);
    }
    moving_ = bodies_.rest && options.rest == RestMotion::ESTIMATED ? Moving::BOTH : Moving::TARGET;
  }

  RegistrationResult run(const RegistrationRequest& request) const
  {
    RunControl control(request, bodies_.centre);
    RegistrationResult result;
    result.room_from_patient = request.room_from_patient;
    result.target_from_rest = request.target_from_rest;
    try
    {
      check(request);
      solve(Run{ request, attenuationImages(request), control }, result);
    }
    catch (const std::invalid_argument& error)
    {
      result.status = RegistrationStatus::INVALID;
      result.reason = error.what();
    }
    result.iterations = control.iterations;
    result.renderings = control.renderings;
    result.duration = control.elapsed();
    return result;
  }

  AttenuationField::Statistics fieldStatistics() const
  {
    AttenuationField::Statistics sum = bodies_.target->fieldStatistics();
    if (bodies_.rest)
    {
      const AttenuationField::Statistics rest = bodies_.rest->fieldStatistics();
      sum.lookups += rest.lookups;
      sum.hits += rest.hits;
    }
    return sum;
  }

  std::size_t memory() const { return bodies_.target->memory() + (bodies_.rest ? bodies_.rest->memory() : 0); }

private:
  struct Run
  {
    const RegistrationRequest& request;
    std::vector<cv::Mat> attenuation;  ///< one a view
    RunControl& control;
  };

  static std::vector<cv::Mat> attenuationImages(const RegistrationRequest& request)
  {
    std::vector<cv::Mat> images(request.views.size());
    for (std::size_t v = 0; v < images.size(); ++v)
    {
      try
      {
        attenuationImage(request.views[v].image, request.intensity, images[v]);
      }
      catch (const std::invalid_argument& error)
      {
        throw std::invalid_argument("view " + request.views[v].geometry.name() + ": " + error.what());
      }
    }
    return images;
  }

  void solve(const Run& run, RegistrationResult& result) const
  {
    const RegistrationRequest& request = run.request;
    const PosePair start{ request.room_from_patient, request.room_from_patient * request.target_from_rest };
    result.similarity_before = linearise(makeViews(run, start, kFine), bodies_, start, Moving::TARGET).meanSimilarity();
    makeViews(run, start, kCoarse);

    Outcome best = descend(run, start);
    if (!best.doubt.empty() && options_.optimiser == Optimiser::GAUSS_NEWTON)
    {
      for (const PosePair& other : otherStarts(run, start))
      {
        Outcome outcome = descend(run, other);
        if (outcome.similarity > best.similarity)
        {
          best = std::move(outcome);
        }
        if (best.doubt.empty() || run.control.stop() != RunControl::Stop::NONE)
        {
          break;
        }
      }
    }
    result.room_from_patient = best.poses.target;
    if (bodies_.rest)
    {
      result.target_from_rest = best.poses.target.inverse() * best.poses.rest;
    }
    result.covariance = best.covariance;
    result.similarity_after = best.similarity;
    result.views = best.views;
    switch (run.control.stop())
    {
      case RunControl::Stop::TIMED_OUT:
        result.status = RegistrationStatus::TIMED_OUT;
        result.reason = message("time budget of ", request.time_budget.count(), " s used up");
        break;
      case RunControl::Stop::CANCELLED:
        result.status = RegistrationStatus::CANCELLED;
        result.reason = "cancelled";
        break;
      case RunControl::Stop::NONE:
        result.status = best.doubt.empty() ? RegistrationStatus::SUCCESS : RegistrationStatus::UNRELIABLE;
        result.reason = best.doubt.empty() ? "converged" : best.doubt;
        break;
    }
  }

  std::vector<ViewLevel> makeViews(const Run& run, const PosePair& poses, const Resolution& resolution) const
  {
    std::vector<ViewLevel> views;
    for (std::size_t v = 0; v < run.attenuation.size(); ++v)
    {
      const RegistrationView& view = run.request.views[v];
      // No finer than the CT's voxels appear on the detector: beyond that there is only noise to compare.
      const double voxel = voxel_edge_ * view.geometry.magnification(poses.target * bodies_.centre);
      const Resolution able{ std::max(resolution.bin_mm, voxel), std::max(resolution.highpass_mm, voxel) };
      views.emplace_back(view.geometry, run.attenuation[v], region(view, poses.target), able);
    }
    return views;
  }

  cv::Rect region(const RegistrationView& view, const RigidTransform& room_from_patient) const
  {
    if (!view.region.empty())
    {
      return view.region;
    }
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
    const Eigen::Vector2i first = seen.min().array().floor().cast<int>();
    const Eigen::Vector2i end = seen.max().array().ceil().cast<int>() + 1;
    return cv::Rect(first.x(), first.y(), end.x() - first.x(), end.y() - first.y());
  }

  /// From coarse to fine.
  Outcome descend(const Run& run, const PosePair& start) const
  {
    Outcome outcome;
    outcome.poses = start;
    PosePair& poses = outcome.poses;
    RunControl& control = run.control;
    try
    {
      control.level = 0;
      const std::vector<ViewLevel> coarse = makeViews(run, poses, kCoarse);
      if (options_.optimiser == Optimiser::GAUSS_NEWTON)
      {
        if (moving_ == Moving::BOTH)
        {
          // As one body first: half as many unknowns reach further.
          gaussNewton(coarse, bodies_, Moving::TOGETHER, kTogether, control, poses);
        }
        gaussNewton(coarse, bodies_, moving_, kApart, control, poses);
        control.level = 1;
      }
      else
      {
        optimiseDerivativeFree(coarse, bodies_, bodies_.rest ? Moving::TOGETHER : moving_, options_.optimiser,
                               *similarity_, 3.0, control, poses);
        control.level = 1;
        optimiseDerivativeFree(makeViews(run, poses, kFineWide), bodies_, moving_, options_.optimiser, *similarity_,
                               0.7, control, poses);
      }
      const std::vector<ViewLevel> fine = makeViews(run, poses, kFine);
      const Linearisation at = options_.optimiser == Optimiser::GAUSS_NEWTON
                                   ? gaussNewton(fine, bodies_, moving_, kFinish, control, poses)
                                   : linearise(fine, bodies_, poses, moving_);
      outcome.similarity = at.meanSimilarity();
      const Linearisation wide = linearise(makeViews(run, poses, kCoarse), bodies_, poses, moving_);
      outcome.views = viewResiduals(fine, at, poses.target * bodies_.centre);
      for (std::size_t v = 0; v < outcome.views.size(); ++v)
      {
        outcome.views[v].coarse_similarity = wide.similarity[v];
      }
      outcome.covariance = poseCovariance(fine, at);
      outcome.doubt = doubt(outcome);
    }
    catch (const std::invalid_argument& error)
    {
      outcome.doubt = error.what();
    }
    return outcome;
  }

  /// Why an outcome is not to be believed; empty if nothing speaks against it.
  std::string doubt(const Outcome& outcome) const
  {
    for (std::size_t v = 0; v < outcome.views.size(); ++v)
    {
      if (!(outcome.views[v].similarity >= options_.min_similarity))
      {
        return message("similarity of view ", v, " is ", outcome.views[v].similarity, ", below ",
                       options_.min_similarity);
      }
      if (!(outcome.views[v].coarse_similarity >= options_.min_coarse_similarity))
      {
        return message("coarse similarity of view ", v, " is ", outcome.views[v].coarse_similarity, ", below ",
                       options_.min_coarse_similarity);
      }
    }
    const double variance = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(outcome.covariance.bottomRightCorner<3, 3>())
                                .eigenvalues()
                                .maxCoeff();
    if (!(variance <= options_.max_deviation_mm * options_.max_deviation_mm))
    {
      return message("expected error is ", std::sqrt(variance), " mm, above ", options_.max_deviation_mm);
    }
    return "";
  }

  /// Starts around the given one, the most promising first, each as far as a few coarse iterations bring it.
  std::vector<PosePair> otherStarts(const Run& run, const PosePair& start) const
  {
    struct Candidate
    {
      PosePair poses;
      double similarity;
    };
    const Moving moving = bodies_.rest ? Moving::TOGETHER : Moving::TARGET;
    std::vector<Candidate> candidates;
    for (int n = 0; n < 12 && run.control.stop() == RunControl::Stop::NONE; ++n)
    {
      Twist offset = Twist::Zero();
      offset[n / 2] = (n % 2 == 0 ? 1.0 : -1.0) * (n < 6 ? kRetryRotation : kRetryTranslation);
      PosePair poses = moved(start, offset, bodies_.centre, moving);
      try
      {
        const Linearisation at = gaussNewton(makeViews(run, poses, kCoarse), bodies_, moving, kTry, run.control, poses);
        candidates.push_back({ poses, at.meanSimilarity() });
      }
      catch (const std::invalid_argument&)
      {
        // Out of a view: no start.
      }
    }
    std::sort(candidates.begin(), candidates.end(),
              [](const Candidate& a, const Candidate& b) { return a.similarity > b.similarity; });
    candidates.resize(std::min(candidates.size(), kRetries), candidates.empty() ? Candidate{} : candidates.front());
    std::vector<PosePair> starts;
    for (const Candidate& candidate : candidates)
    {
      starts.push_back(candidate.poses);
    }
    return starts;
  }

  RegistrationOptions options_;
  Eigen::AlignedBox3d box_;
  std::unique_ptr<const Similarity> similarity_;
  Bodies bodies_;
  double voxel_edge_;  ///< geometric mean [mm]
  Moving moving_;
};

Registration::Registration(const BodyModel& bodies, const Eigen::AlignedBox3d& target_box,
                           const RegistrationOptions& options)
  : implementation_(std::make_unique<Implementation>(bodies, target_box, options))
{
}

Registration::~Registration() = default;

RegistrationResult Registration::run(const RegistrationRequest& request) const
{
  return implementation_->run(request);
}

std::size_t Registration::memory() const
{
  return implementation_->memory();
}

AttenuationField::Statistics Registration::fieldStatistics() const
{
  return implementation_->fieldStatistics();
}
}  // namespace xray_tracking
