#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/projection/attenuation_field.h"
#include "xray_tracking_core/projection/pixel_grid.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/body_model.h"

namespace xray_tracking
{
enum class Optimiser
{
  GAUSS_NEWTON,  ///< Levenberg-Marquardt on least squares of normalised images, with a Huber norm
  BOBYQA         ///< derivative-free, on `similarity`
};

/// Where line integrals come from.
enum class Projector
{
  SHEAR_WARP,
  RAY_CASTING,       ///< exact, ray by ray; BOBYQA only
  ATTENUATION_FIELD  ///< the same, kept for later poses (AttenuationField); BOBYQA only
};

struct RegistrationOptions
{
  Optimiser optimiser = Optimiser::GAUSS_NEWTON;
  /// What BOBYQA maximises (makeSimilarity()), the mean over the views.
  std::string similarity = "gradient_correlation";
  /// Shear-warp is faster than either other one by far; the attenuation field is what ray casting needs to be usable.
  Projector projector = Projector::SHEAR_WARP;
  /// Probability from which a result is believed (RegistrationResult::probability), 0 to 1.
  double min_probability = 0.95;

  /// @throws std::invalid_argument naming the option, its value and what was expected
  void validate() const;
};

/// A view's saturation k where nothing is known of it yet, and the most that is taken for possible.
constexpr double kUsualSaturation = 0.2;
constexpr double kMaxSaturation = 3.0;

/// One view of an exposure.
struct RegistrationView
{
  ProjectionGeometry geometry;
  cv::Mat image;      ///< as AttenuationImage takes it, of the geometry's size
  cv::Rect region{};  ///< pixels to compare; empty: where the target box is seen from the start
  cv::Mat usable{};   ///< CV_8UC1 of the image's size, 0 for pixels that do not count; empty: all do
  /// Start of the saturation k, which is estimated along, 0 to 3; best the last exposure's result. Scatter, beam
  /// hardening and glare make of the line integral L what is measured as (1 - exp(-k L)) / k: 0 for an ideal beam, 0.1
  /// to 0.3 for a patient's trunk, 1 and more for metal.
  double saturation = kUsualSaturation;
};

/// How far a registration has come.
struct RegistrationProgress
{
  int level = 0;          ///< resolution, from 0, coarse to fine
  int iteration = 0;      ///< over all levels
  double similarity = 0;  ///< at this level, mean over the views
  RigidTransform room_from_patient;
};

/// What is known of the pose beforehand.
enum class Search
{
  NEAR,  ///< the start is about right: descends from it, and searches around it if that fails
  WIDE   ///< it may be anywhere within the bounds: searches all of them, and says what else is alike
};

/// Bounds of a wide search [mm, rad]: what 25 mm and 10 degrees along and about every axis come to, and the widest;
/// time grows with their third powers.
constexpr double kUsualSearch = 45.0;
constexpr double kUsualSearchRotation = 0.32;
constexpr double kMaxSearch = 100.0;
constexpr double kMaxSearchRotation = 0.8;

struct RegistrationRequest
{
  std::vector<RegistrationView> views;  ///< one or more
  IntensityModel intensity;
  RigidTransform room_from_patient = RigidTransform::Identity();  ///< start
  /// Start of the rest, relative to the target, in the patient frame: room_from_rest = room_from_patient *
  /// target_from_rest. Best the last exposure's result.
  RigidTransform target_from_rest = RigidTransform::Identity();
  Search search = Search::NEAR;
  /// Whether the start follows from a believed pose, of an exposure shortly before, so that it is at the right
  /// vertebra.
  bool start_verified = false;
  /// Of the target's centre from the start, > 0 [mm]. The tighter the better: beyond 18 mm the next vertebra is in
  /// question too. At most kMaxSearch of a wide search.
  double max_translation_mm = 30.0;
  double max_rotation_rad = 0.26;  ///< from the start, > 0, at most pi, or kMaxSearchRotation of a wide search [rad]
  std::chrono::duration<double> time_budget{ 5.0 };
  /// Called before every rendering of a pose, from run()'s thread; returns whether to go on. May be empty.
  std::function<bool(const RegistrationProgress&)> progress;
};

enum class RegistrationStatus
{
  SUCCESS,
  UNRELIABLE,  ///< converged, but by its own figures not to be believed
  TIMED_OUT,   ///< the budget ended; the best so far, its figures as far as they are known
  CANCELLED,   ///< by `progress`; the best so far
  INVALID      ///< bad request; the start is returned
};

/// Figures of one view at the result.
struct ViewResidual
{
  double similarity = 0.0;         ///< correlation coefficient of the high-passed images as fine as the CT is, -1 to 1
  double coarse_similarity = 0.0;  ///< the same at the coarsest level's resolution; 0 where the start is verified
  double noise = 0.0;              ///< root mean square of the difference of the normalised images, 0 to 2
  /// By how much the view alone would move the target along what it sees best, two directions across its central ray
  /// [mm]: large where the views do not agree.
  double pull_mm = 0.0;
  /// RegistrationView::saturation, estimated along. Where the image does not tell it, near 0.2.
  double saturation = 0.0;
};

/// A result is believed if it is probable enough that the target is off by less than this, root mean square over its
/// box [mm].
constexpr double kBelievedError = 1.5;

/// What a result's probability follows from. No figure hangs on dose, tone, pitch or magnification.
struct BeliefFigures
{
  /// Of the target, root mean square over its box's corners, by how far apart what tiles of the images say is [mm].
  double expected_error_mm = 0.0;
  double least_similarity = 0.0;  ///< of the views' ViewResidual::similarity
  /// Of the views' ViewResidual::coarse_similarity. The probability does not follow from it: it says whether neighbours
  /// have to be looked at.
  double least_coarse_similarity = 0.0;
  double pull_mm = 0.0;  ///< the largest of the views' ViewResidual::pull_mm
  /// How much more alike the views are than with the target shifted elsewhere, by 5 to 25 mm: mean correlation here and
  /// in the best other place, and in standard deviations of all other places.
  double here = 0.0;
  double rival = 0.0;
  double distinctness = 0.0;
  /// Share of the similarity that is lost with the target 3 mm aside, to that side of what its pose is known least
  /// along on which less is lost: below 0 where it would be more alike.
  double loss_aside = 0.0;
};

/// Another place that was found, and is not the answer.
struct Rival
{
  RigidTransform room_from_patient;
  double distance_mm = 0.0;   ///< from the answer, root mean square over the target's box
  double rotation_rad = 0.0;  ///< from the answer
  double similarity = 0.0;    ///< as RegistrationResult::similarity_after
  /// Logarithm of the odds that the answer is the right place and not this one, by similarity and by nearness to the
  /// start.
  double odds = 0.0;
};

struct RegistrationResult
{
  RegistrationStatus status = RegistrationStatus::INVALID;
  std::string reason;        ///< why it stopped, or why it is not to be believed; never empty
  double probability = 0.0;  ///< that the target is off by less than kBelievedError, 0 to 1; 0 where nothing is known
  BeliefFigures figures;     ///< zeros where nothing is known
  RigidTransform room_from_patient = RigidTransform::Identity();
  RigidTransform target_from_rest = RigidTransform::Identity();  ///< as requested if there is one body alone
  /// Of the twist (rotation [rad], translation [mm]) about the target's centre in the room:
  /// motionAbout(room_from_patient * centre, twist) * room_from_patient.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  double similarity_before = 0.0;  ///< mean over the views of ViewResidual::similarity at the start
  double similarity_after = 0.0;
  int iterations = 0;
  int renderings = 0;  ///< poses that were rendered, all bodies and views
  std::vector<ViewResidual> views;
  /// Other places that were looked at, most similar first; never all that there are.
  std::vector<Rival> rivals;
  std::chrono::duration<double> duration{ 0.0 };

  /// `covariance` as that of (translation of the patient frame's origin [mm], rotation vector about the fixed room axes
  /// [rad]); zero where it is not known. @param target_centre patient frame [mm]
  Eigen::Matrix<double, 6, 6> poseCovariance(const Eigen::Vector3d& target_centre) const;
};

/// Registers a CT to X-ray images: finds the pose of the target, and of the rest of the body as a nuisance, at which
/// their DRRs are most like the images.
///
/// Images are compared as attenuation, binned and high-passed with a width that goes from coarse (bins of 2.2 mm, 11
/// mm) to fine (bins of 1.1 mm, 1.1 mm) at the target, or to where the CT's voxels set the limit, each view brought to
/// mean 0 and norm 1. Poses are twists about the target's centre.
class Registration
{
public:
  /// @param target_box patient frame [mm]
  /// @throws std::invalid_argument as validate(), or for bodies without a voxel or an empty box
  Registration(const BodyModel& bodies, const Eigen::AlignedBox3d& target_box, const RegistrationOptions& options = {});
  ~Registration();

  /// Never throws for bad requests: they give INVALID and the reason. Const and thread safe; uses all cores.
  RegistrationResult run(const RegistrationRequest& request) const;

  /// What a detector sees of the CT where all of it has one pose: line integrals of attenuation at the grid's points,
  /// from volumes as fine as the grid. Const and thread safe; uses the caller's TBB arena.
  /// @param line_integrals out, CV_32FC1, size.y() rows x size.x() columns
  /// @throws std::invalid_argument if the pose is not rigid
  void render(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& room_from_patient,
              cv::Mat& line_integrals) const;

  /// Bytes of volumes and attenuation fields held.
  std::size_t memory() const;
  /// Of all attenuation fields; zeros for other projectors.
  AttenuationField::Statistics fieldStatistics() const;

private:
  class Implementation;
  std::unique_ptr<const Implementation> implementation_;
};
}  // namespace xray_tracking
