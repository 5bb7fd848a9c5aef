#include "xray_tracking_core/geometry/geometry_import.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>
#include <stdexcept>

#include <Eigen/Dense>
#include <boost/math/constants/constants.hpp>

#include "import_words.h"
#include "view_camera.h"
#include "xray_tracking_core/image/lens_distortion.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
constexpr double kNearEdge = 0.1;    // of the image
constexpr double kTellMiss = 5.0;    // of rays from what all views see [mm]
constexpr double kTellAngle = 20.0;  // between the views [degrees]
constexpr double kTellSkew = 1e-3;   // px
constexpr double kSamePitch = 0.01;  // of pitches and focal lengths
constexpr double kSamePlace = 1.0;   // mm, of sources
constexpr double kParallel = 1e-4;   // smallest eigenvalue of the normal matrix: 1 degree between two views
constexpr double kFarSide = 2.0;     // magnification: the patient stands nearer to the panel in all known rooms

bool isPixelOf(const ImportedView& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d p = view.matrix * point.homogeneous();
  const Eigen::Array2d pixel = p.head<2>() / p.z();
  return pixel.allFinite() && (pixel >= -0.5).all() && (pixel <= view.image_size.cast<double>().array() - 0.5).all();
}

/// The images were turned after the file was written.
void flip(ImportedView& view, const GeometryImportOptions& options)
{
  Eigen::Matrix3d turned = Eigen::Matrix3d::Identity();
  if (options.flip_columns.count(view.name) != 0)
  {
    turned(0, 0) = -1.0;
    turned(0, 2) = view.image_size.x() - 1.0;
    turnTangential(view.distortion, 3);
  }
  if (options.flip_rows.count(view.name) != 0)
  {
    turned(1, 1) = -1.0;
    turned(1, 2) = view.image_size.y() - 1.0;
    turnTangential(view.distortion, 2);
  }
  view.matrix = turned * view.matrix;
}

void nameViews(std::vector<ImportedView>& views, const GeometryImportOptions& options)
{
  if (!options.names.empty() && options.names.size() != views.size())
  {
    throw std::invalid_argument(
        sentence("--names has ", options.names.size(), " names for ", views.size(), " views: expected one each"));
  }
  if (views.size() > 26)
  {
    throw std::invalid_argument(sentence(views.size(), " views: expected 2 to 26"));
  }
  std::set<std::string> names;
  for (std::size_t n = 0; n < views.size(); ++n)
  {
    ImportedView& view = views[n];
    view.name = !options.names.empty()                         ? options.names[n]
                : !view.name.empty()                           ? view.name
                : options.default_names.size() == views.size() ? options.default_names[n]
                                                               : std::string("detector_") + static_cast<char>('a' + n);
    if (!names.insert(view.name).second)
    {
      fail(view.where, "is a second detector '" + view.name + "': expected names that differ; give --names");
    }
  }
  for (const auto& [option, flipped] :
       { std::make_pair("--flip_rows", options.flip_rows), std::make_pair("--flip_columns", options.flip_columns) })
  {
    for (const std::string& name : flipped)
    {
      if (names.count(name) == 0)
      {
        throw std::invalid_argument(sentence(option, ": '", name, "' is no detector's name: expected one of ",
                                             views.front().name, ", ", views[1].name, " ..."));
      }
    }
  }
}

void checkPlaces(const std::vector<ImportedView>& views, double unit)
{
  for (std::size_t n = 0; n < views.size(); ++n)
  {
    const Eigen::Vector3d source = cameraOf(views[n]).source;
    for (std::size_t other = 0; other < n; ++other)
    {
      if (!((source - cameraOf(views[other]).source).norm() > kSamePlace * std::min(1.0, unit)))
      {
        fail(views[n].where, "its source is at " + placeOf(source) + ", as that of " + views[other].where +
                                 ": expected views from different places; is one there twice? Are rotation and "
                                 "translation the camera's pose (camera to room)? Then invert them");
      }
    }
  }
}

/// The room point nearest to the rays through the images' middles, if they are not parallel. Needs no signs.
std::optional<Eigen::Vector3d> meetingPoint(const std::vector<ImportedView>& views)
{
  Eigen::Matrix3d normal_matrix = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right_side = Eigen::Vector3d::Zero();
  for (const ImportedView& view : views)
  {
    const Eigen::Matrix3d inverse = view.matrix.leftCols<3>().inverse();
    const Eigen::Vector2d middle = 0.5 * (view.image_size.cast<double>().array() - 1.0);
    const Eigen::Vector3d direction = (inverse * middle.homogeneous()).normalized();
    const Eigen::Vector3d source = -inverse * view.matrix.col(3);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - direction * direction.transpose();
    normal_matrix += across;
    right_side += across * source;
  }
  if (!(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(normal_matrix).eigenvalues().minCoeff() > kParallel))
  {
    return std::nullopt;
  }
  return normal_matrix.ldlt().solve(right_side);
}

/// That decides what is in front of the sources. @return nothing if no view needs it, and there is none
std::optional<Eigen::Vector3d> pointOf(const std::vector<ImportedView>& views, const GeometryImportOptions& options)
{
  const std::optional<Eigen::Vector3d> point = options.point ? options.point : meetingPoint(views);
  const bool all_known =
      std::all_of(views.begin(), views.end(), [](const ImportedView& view) { return view.front_is_known; });
  for (const ImportedView& view : views)
  {
    if (point && isPixelOf(view, *point))
    {
      continue;
    }
    if (options.point)
    {
      throw std::invalid_argument("--point is " + placeOf(*options.point) + " mm, which " + view.where +
                                  " does not have in its image: expected a room point that all views see");
    }
    if (!all_known)
    {
      fail(view.where, (point ? "its image does not have the point nearest to the rays through the images' middles, " +
                                    placeOf(*point) + " mm"
                              : std::string("the rays through the images' middles are parallel")) +
                           ": expected views of one place. Do the files belong together? Are the coordinates those of "
                           "the room, in mm? If all is right, give a point that all views see, --point X Y Z" +
                           (view.hint.empty() ? "" : ". Else, " + view.hint));
    }
    return std::nullopt;
  }
  return point;
}

double sourceToDetectorOf(const ImportedView& view, const Camera& camera, const GeometryImportOptions& options)
{
  if (view.pixel_pitch || options.pixel_pitch)
  {
    const Eigen::Vector2d pitch = view.pixel_pitch ? *view.pixel_pitch : *options.pixel_pitch;
    const Eigen::Vector2d distances = pitch.cwiseProduct(camera.focal_length);
    if (!(std::abs(distances.y() - distances.x()) <= kSamePitch * distances.x()))
    {
      fail(view.where, sentence("a pitch of ", pitch.x(), " x ", pitch.y(), " mm at focal lengths of ",
                                camera.focal_length.x(), " and ", camera.focal_length.y(), " px puts the panel at ",
                                distances.x(), " and at ", distances.y(), " mm: expected the same to 1 %"));
    }
    return distances.x();
  }
  if (options.source_to_detector)
  {
    return *options.source_to_detector;
  }
  throw std::invalid_argument(
      view.where +
      ": the panel's distance is open: expected --pitch MM or --sdd MM. If neither is known, any pitch will "
      "do that puts the panel beyond the patient: projections are the same");
}

/// @throws std::runtime_error naming the file if no detector is like that
ProjectionGeometry detectorOf(const ImportedView& view, const Camera& camera, double sdd)
{
  RigidTransform room_from_optical = RigidTransform::Identity();
  room_from_optical.linear() = camera.axes.transpose();
  room_from_optical.translation() = camera.source;
  try
  {
    ProjectionGeometry detector = ProjectionGeometry::fromIntrinsics(view.name, view.image_size, camera.focal_length,
                                                                     camera.foot, room_from_optical, sdd);
    if (!view.distortion.model.empty())
    {
      LensDistortion(view.distortion.model, view.distortion.values, detector);  // refuses what is of no use
    }
    return detector;
  }
  catch (const std::invalid_argument& error)
  {
    fail(view.where, error.what());
  }
}

/// What a view's panel is, in words.
std::string remarkOf(const ImportedView& view, const ProjectionGeometry& detector, const Camera& camera,
                     const std::optional<Eigen::Vector3d>& point)
{
  std::ostringstream text;
  text.precision(6);
  text << detector.name() << " (" << view.where << "): source " << placeOf(detector.source()) << " mm, panel at "
       << detector.sourceToDetector() << " mm with a pitch of " << detector.pixelPitch().x() << " x "
       << detector.pixelPitch().y() << " mm (" << detector.imageSize().x() * detector.pixelPitch().x() << " x "
       << detector.imageSize().y() * detector.pixelPitch().y() << " mm), principal point " << listOf(detector.foot())
       << " px of " << detector.imageSize().x() << " x " << detector.imageSize().y();
  if (point)
  {
    text << ", what all views see at " << detector.depth(*point) << " mm (magnification "
         << detector.magnification(*point) << ")";
    if (detector.magnification(*point) > kFarSide)
    {
      text << "; that is nearer to the source than to the panel: are they swapped?";
    }
  }
  const Eigen::Array2d at = detector.foot().array() / (detector.imageSize().cast<double>().array() - 1.0);
  if (!((at >= kNearEdge).all() && (at <= 1.0 - kNearEdge).all()))
  {
    text << "; the principal point is near the image's edge or outside: is the first pixel's place (origin_mm, "
            "RTImagePosition) that of its centre, in mm?";
  }
  if (camera.skew > kTellSkew)
  {
    text << "; a skew of " << camera.skew << " px at the image's edge is left out";
  }
  return text.str();
}

/// How well the views agree about what they all see.
std::string remarkOn(const Eigen::Vector3d& point, const std::vector<ProjectionGeometry>& detectors)
{
  double miss = 0.0;
  double least_cosine = 1.0;
  for (const ProjectionGeometry& detector : detectors)
  {
    const Ray ray = detector.backProject(0.5 * (detector.imageSize().cast<double>().array() - 1.0).matrix());
    const Eigen::Vector3d to_point = point - ray.source;
    miss = std::max(miss, to_point.cross(ray.direction).norm());
    for (const ProjectionGeometry& other : detectors)
    {
      // Opposite views see the same.
      least_cosine = std::min(least_cosine, std::abs(to_point.normalized().dot((point - other.source()).normalized())));
    }
  }
  const double angle = std::acos(std::min(least_cosine, 1.0)) / kDegree;
  std::ostringstream text;
  text.precision(3);
  text << "all views see " << placeOf(point) << " mm";
  if (miss > kTellMiss)
  {
    text << ", which the rays through the images' middles pass at up to " << miss
         << " mm: if the images were not taken so, look whether rotations are transposed (MATLAB has them so)";
  }
  if (angle < kTellAngle)
  {
    text << "; they are " << angle << " degrees apart at most, which leaves depth " << 1.0 / std::sin(angle * kDegree)
         << " times as uncertain: are angles in degrees?";
  }
  return text.str();
}

std::string leftHanded(const std::vector<const ImportedView*>& views, const std::string& swapped)
{
  std::string names, places;
  for (const ImportedView* view : views)
  {
    names += " " + view->name;
    places += (places.empty() ? "" : ", ") + view->where;
  }
  const ImportedView& first = *views.front();
  const std::string flips = first.flip == "columns" ? "Flip its images left to right and give --flip_columns" + names +
                                                          ", or upside down and --flip_rows" + names
                                                    : "Flip its images upside down and give --flip_rows" + names +
                                                          ", or left to right and --flip_columns" + names;
  return places +
         ": the panel is left-handed, its images are mirrored: expected columns and rows as they are seen from "
         "the source (x_direction cross y_direction from the source to the panel). " +
         swapped + flips + (first.hint.empty() ? "" : " (" + first.hint + ")");
}
void checkOptions(const GeometryImportOptions& options)
{
  if (options.pixel_pitch && options.source_to_detector)
  {
    throw std::invalid_argument("--pitch and --sdd: expected one of them, the other follows");
  }
  if (options.pixel_pitch)
  {
    requireOption(options.pixel_pitch->allFinite() && options.pixel_pitch->minCoeff() > 0.0, "--pitch",
                  options.pixel_pitch->transpose(), "positive numbers, mm");
  }
  if (options.source_to_detector)
  {
    requireOption(std::isfinite(*options.source_to_detector) && *options.source_to_detector > 0.0, "--sdd",
                  *options.source_to_detector, "a positive number, mm");
  }
  if (options.image_size)
  {
    requireOption(options.image_size->minCoeff() >= 1 && options.image_size->maxCoeff() <= 16384, "--image_size",
                  options.image_size->transpose(), "columns and rows, 1 to 16384");
  }
  if (options.point)
  {
    requireOption(options.point->allFinite(), "--point", options.point->transpose(), "finite numbers, mm");
  }
}
}  // namespace

ImportedGeometry importGeometry(const std::vector<std::string>& files, const GeometryImportOptions& options)
{
  checkOptions(options);
  std::vector<ImportedView> views;
  for (const std::string& file : files)
  {
    const std::vector<ImportedView> read = readViews(file, options);
    views.insert(views.end(), read.begin(), read.end());
  }
  if (views.size() < 2)
  {
    throw std::invalid_argument(
        sentence(views.size(), " view in the files, ", views.front().where, ": expected two or more"));
  }
  nameViews(views, options);
  for (ImportedView& view : views)
  {
    checkMatrix(view);
    flip(view, options);
  }
  checkPlaces(views, options.unit.value_or(1.0));
  const std::optional<Eigen::Vector3d> point = pointOf(views, options);

  std::vector<Camera> cameras;
  std::vector<const ImportedView*> mirrored;
  std::string swapped;
  for (ImportedView& view : views)
  {
    if (!view.front_is_known && view.matrix.row(2).dot(point->homogeneous()) < 0.0)
    {
      view.matrix = -view.matrix;
    }
    const Camera camera = cameraOf(view);
    cameras.push_back(camera);
    if (camera.axes.determinant() < 0.0)
    {
      mirrored.push_back(&view);
      if (view.pixel_pitch && point)
      {
        const double sdd = view.pixel_pitch->x() * camera.focal_length.x();
        const double depth = camera.axes.row(2).dot(*point - camera.source);
        if (sdd > kFarSide * depth)
        {
          swapped = sentence("If source and panel are swapped, which puts what all views see ", depth,
                             " mm from the source and ", sdd - depth, " mm from the panel, swap them. Else: ");
        }
      }
    }
  }
  if (!mirrored.empty())
  {
    throw std::runtime_error(leftHanded(mirrored, swapped));
  }

  ImportedGeometry imported;
  for (std::size_t n = 0; n < views.size(); ++n)
  {
    const ImportedView& view = views[n];
    const Camera& camera = cameras[n];
    const double sdd = sourceToDetectorOf(view, camera, options);
    imported.detectors.push_back(detectorOf(view, camera, sdd));
    const ProjectionGeometry& detector = imported.detectors.back();
    const std::string doubt = point ? implausibility(detector, *point) : implausibility(detector);
    // --unit mm says that distances are right, but not that the panel stands before the patient.
    const double depth = point ? detector.depth(*point) : 0.5 * detector.sourceToDetector();
    const bool possible = depth > 0.0 && depth < detector.sourceToDetector();
    if (!doubt.empty() && !(possible && options.unit == 1.0))
    {
      const bool advise = possible && !view.is_in_mm && !options.unit;
      fail(view.where, doubt + (advise ? " Give --unit m or cm; if distances are right, --unit mm" : ""));
    }
    imported.distortions.push_back(view.distortion);
    imported.remarks.push_back(remarkOf(view, detector, camera, point));
  }
  imported.point = point;
  imported.remarks.push_back(point ? remarkOn(*point, imported.detectors)
                                   : "no room point is in the middle of all images: do the views belong together?");
  return imported;
}

}  // namespace xray_tracking
