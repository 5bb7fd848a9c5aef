#include "xray_tracking_registration/registration.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "xray_tracking_core/evaluation/evaluation.h"

#include "descender.h"
#include "look_alikes.h"
#include "message.h"
#include "rivalry.h"
#include "run_control.h"
#include "wide_search.h"

namespace xray_tracking
{
namespace
{
/// Views as similar as this at the start are near enough for the fine level alone.
constexpr double kNearlyThere = 0.5;
/// Views as similar as this, fine and coarse, show no other vertebra.
constexpr double kSure = 0.72;
/// Where another place is looked for along the patient's long axis if the CT shows none that looks like the target
/// [mm].
constexpr double kNeighbour = 18.0;
constexpr double kTurned = 3.0 * M_PI / 180.0;  // from the start: worth a try from its orientation
/// Another place with this share of the similarity may be the right one with the rest in another posture.
constexpr double kMayBe = 0.75;

// What is searched around a start whose descents fail.
constexpr double kRetryTranslation = 20.0;  // [mm]
constexpr double kRetryRotation = 12.0 * M_PI / 180.0;

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
    if (request.search == Search::WIDE && !view.region.empty())
    {
      throw std::invalid_argument(message("view ", view.geometry.name(),
                                          ": a region to compare, expected none with a wide search, as the target may "
                                          "be anywhere"));
    }
    if (!(view.saturation >= 0.0 && view.saturation <= kMaxSaturation))
    {
      throw std::invalid_argument(message("view ", view.geometry.name(), ": its saturation is ", view.saturation,
                                          ": expected 0 to ", kMaxSaturation));
    }
    if (!view.usable.empty() && (view.usable.size() != view.image.size() || view.usable.type() != CV_8UC1))
    {
      throw std::invalid_argument("view " + view.geometry.name() +
                                  ": usable: expected nothing, or 8 bits a pixel of the image");
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
  if (request.search == Search::WIDE &&
      !(request.max_translation_mm <= kMaxSearch && request.max_rotation_rad <= kMaxSearchRotation))
  {
    throw std::invalid_argument(message("bounds of a wide search are ", request.max_translation_mm, " mm and ",
                                        request.max_rotation_rad, " rad: expected at most ", kMaxSearch, " mm and ",
                                        kMaxSearchRotation, " rad"));
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
    : options_(options), box_(box)
  {
    options.validate();
    if (box.isEmpty() || !box.min().allFinite() || !box.max().allFinite())
    {
      throw std::invalid_argument("target box: expected finite corners, min below max");
    }
    neighbours_ = neighboursOf(bodies, box);
    bodies_ = std::make_unique<const Bodies>(bodies, box, kFine.bin_mm, options.projector);
    const double voxel = std::cbrt(std::abs(bodies.target.grid.patient_from_index.linear().determinant()));
    descender_ = std::make_unique<const Descender>(*bodies_, box, voxel, options);
  }

  RegistrationResult run(const RegistrationRequest& request) const
  {
    RunControl control(request, bodies_->centre);
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

  void render(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& room_from_patient,
              cv::Mat& line_integrals) const
  {
    const Eigen::Vector3d centre = room_from_patient * bodies_->centre;
    cv::Mat rest;
    bodies_->target->render(geometry, pixels, room_from_patient, centre, line_integrals);
    bodies_->rest->render(geometry, pixels, room_from_patient, centre, rest);
    line_integrals += rest;
  }

  AttenuationField::Statistics fieldStatistics() const
  {
    AttenuationField::Statistics sum = bodies_->target->fieldStatistics();
    const AttenuationField::Statistics rest = bodies_->rest->fieldStatistics();
    sum.lookups += rest.lookups;
    sum.hits += rest.hits;
    return sum;
  }

  std::size_t memory() const { return bodies_->target->memory() + bodies_->rest->memory(); }

private:
  static std::vector<AttenuationImage> attenuationImages(const RegistrationRequest& request)
  {
    std::vector<AttenuationImage> images;
    for (const RegistrationView& view : request.views)
    {
      try
      {
        images.emplace_back(view.image, request.intensity);
      }
      catch (const std::invalid_argument& error)
      {
        throw std::invalid_argument("view " + view.geometry.name() + ": " + error.what());
      }
    }
    return images;
  }

  void solve(const Run& run, RegistrationResult& result) const
  {
    const RegistrationRequest& request = run.request;
    PosePair start{ request.room_from_patient,
                    bodies_->one ? request.room_from_patient : request.room_from_patient * request.target_from_rest };
    for (const RegistrationView& view : request.views)
    {
      start.saturation.push_back(view.saturation);
    }
    Outcome best;
    if (request.search == Search::WIDE)
    {
      Found found = searchAround(run, *bodies_, *descender_, box_, start,
                                 { request.max_translation_mm, request.max_rotation_rad });
      best = std::move(found.answer);
      result.rivals = std::move(found.rivals);
    }
    else
    {
      best = descendFrom(run, start, result);
    }
    if (best.doubt.empty() && run.control.atBounds(best.poses.target))
    {
      doubtFor(message("it ends at the bounds of ", request.max_translation_mm, " mm and ", request.max_rotation_rad,
                       " rad from the start"),
               best);
    }
    result.rivals = weighRivals(run, box_, std::move(result.rivals), options_.min_probability, best);
    result.room_from_patient = best.poses.target;
    if (!bodies_->one)
    {
      result.target_from_rest = best.poses.target.inverse() * best.poses.rest;
    }
    result.covariance = best.covariance;
    result.figures = best.figures;
    result.probability = best.probability;
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

  /// The less probable one of both places becomes a rival.
  void contend(const Run& run, Outcome other, Outcome& best, std::vector<Rival>& rivals) const
  {
    if (other.views.empty())
    {
      return;
    }
    const bool elsewhere = targetRegistrationError(other.poses.target, best.poses.target, box_) > kElsewhere;
    const auto may_be = [](const Outcome& a, const Outcome& b) { return a.similarity > kMayBe * b.similarity; };
    if (elsewhere && may_be(best, other) && may_be(other, best))
    {
      descender_->seekRest(run, best);
      descender_->seekRest(run, other);
    }
    if (best.views.empty() || oddsOver(run, other, rivalFrom(best)) > 0.0)
    {
      std::swap(best, other);
    }
    if (!other.views.empty())
    {
      rivals.push_back(rivalFrom(other));
    }
  }

  /// Whether what was found is like no other vertebra.
  static bool isSure(const Outcome& outcome)
  {
    return std::min(outcome.figures.least_similarity, outcome.figures.least_coarse_similarity) >= kSure;
  }

  /// Descends from a start that is about right.
  Outcome descendFrom(const Run& run, const PosePair& start, RegistrationResult& result) const
  {
    const RegistrationRequest& request = run.request;
    FineLevel fine = descender_->fineLevel(run, start);
    result.similarity_before = fine.at.meanSimilarity();
    const bool near = std::all_of(fine.at.models.begin(), fine.at.models.end(),
                                  [](const ViewModel& model) { return model.similarity >= kNearlyThere; });
    const bool by_newton = options_.optimiser == Optimiser::GAUSS_NEWTON;
    const Path first = request.start_verified && by_newton ? Path::SHIFT : Path::COARSE;
    Outcome best =
        near && by_newton ? descender_->descend(run, start, std::move(fine)) : descender_->descend(run, start, first);
    if (options_.optimiser != Optimiser::GAUSS_NEWTON)
    {
      return best;
    }
    const auto stopped = [&] { return run.control.stop() != RunControl::Stop::NONE; };
    const auto failed = [&] { return !best.doubt.empty() && !stopped(); };
    if (failed() || (!request.start_verified && !isSure(best)))
    {
      // One is led by what most of the images show, the other by the start: neither is always right.
      for (const Path path : { Path::MEDIUM, Path::COARSE })
      {
        if (stopped() || (path == first && !near) || (path == Path::MEDIUM && descender_->moving() != Moving::BOTH))
        {
          continue;
        }
        contend(run, descender_->descend(run, start, path), best, result.rivals);
      }
    }
    if (failed())
    {
      Found found = searchAround(run, *bodies_, *descender_, box_, start,
                                 { std::min(run.request.max_translation_mm, kRetryTranslation),
                                   std::min(run.request.max_rotation_rad, kRetryRotation) });
      result.rivals.insert(result.rivals.end(), found.rivals.begin(), found.rivals.end());
      contend(run, std::move(found.answer), best, result.rivals);
    }
    if (!best.doubt.empty())
    {
      // What cannot be compared at the start is the request's fault: refused as INVALID.
      descender_->makeViews(run, start, kCoarse);
    }
    else
    {
      compareWithNeighbours(run, best, result.rivals);
    }
    return best;
  }

  /// Shifts to where the target is looked for as well, patient frame [mm]: here, then to either side of it.
  static std::vector<Eigen::Vector3d> neighboursOf(const BodyModel& bodies, const Eigen::AlignedBox3d& box)
  {
    std::vector<Eigen::Vector3d> shifts = lookAlikes(bodies, box);
    if (shifts.empty())
    {
      shifts = { -kNeighbour * Eigen::Vector3d::UnitZ() };
    }
    if (shifts.size() == 1)
    {
      shifts.push_back(-shifts.front());
    }
    shifts.insert(shifts.begin(), Eigen::Vector3d::Zero());
    return shifts;
  }

  /// Puts what was found to the test where its views are not alike beyond doubt: whether the same place from the
  /// start's orientation, or the next vertebra to either side, is more probable.
  void compareWithNeighbours(const Run& run, Outcome& best, std::vector<Rival>& rivals) const
  {
    const RigidTransform& start = run.request.room_from_patient;
    const RigidTransform found = best.poses.target;
    if (nearVerifiedStart(run, found))
    {
      return;
    }
    for (const Eigen::Vector3d& side : neighbours_)
    {
      if (isSure(best) || !best.doubt.empty() || run.control.stop() != RunControl::Stop::NONE)
      {
        return;
      }
      PosePair there{ start, start };
      there.target.translation() += found * bodies_->centre - start * bodies_->centre + found.linear() * side;
      if (descender_->moving() == Moving::TARGET)
      {
        there.rest = start * run.request.target_from_rest;
      }
      else
      {
        there.rest = bodies_->one ? there.target : there.target * run.request.target_from_rest;
      }
      if (!run.control.inBounds(there.target) || (side.isZero() && rotationAngle(start.inverse() * found) < kTurned))
      {
        continue;
      }
      const bool medium = side.isZero() && descender_->moving() == Moving::BOTH;
      contend(run, descender_->descend(run, there, medium ? Path::MEDIUM : Path::COARSE), best, rivals);
    }
  }

  RegistrationOptions options_;
  Eigen::AlignedBox3d box_;
  std::vector<Eigen::Vector3d> neighbours_;
  std::unique_ptr<const Bodies> bodies_;
  std::unique_ptr<const Descender> descender_;
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

void Registration::render(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                          const RigidTransform& room_from_patient, cv::Mat& line_integrals) const
{
  implementation_->render(geometry, pixels, room_from_patient, line_integrals);
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
