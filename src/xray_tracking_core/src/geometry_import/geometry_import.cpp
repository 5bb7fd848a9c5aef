#include "xray_tracking_core/geometry/geometry_import.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include <yaml-cpp/yaml.h>
#include <Eigen/Dense>

#include "../sequence/detector_node.h"
#include "imported_view.h"
#include "xray_tracking_core/image/lens_distortion.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr std::uintmax_t kMaxTextSize = 64U << 20U;
// mm. From the source to the patient, to the panel, and the panel's sides: a bench for hands to a room of its own.
constexpr double kNearest = 200.0;
constexpr double kFarthest = 10000.0;
constexpr double kFarthestPanel = 15000.0;
constexpr double kSmallest = 10.0;
constexpr double kLeastDistance = 0.01;  // in metres by mistake, it shall be told
constexpr double kLargest = 2000.0;
/// Of a panel that has none; the pixels' edges move by it at most.
constexpr double kMaxSkew = 0.5;     // px
constexpr double kTellSkew = 1e-3;   // px
constexpr double kSamePitch = 0.01;  // of pitches and focal lengths
constexpr double kSamePlace = 1.0;   // mm, of sources
constexpr double kParallel = 1e-4;   // smallest eigenvalue of the normal matrix: 1 degree between two views
constexpr double kFarSide = 2.0;     // magnification: the patient stands nearer to the panel in all known rooms
constexpr double kNoMatrix = 1e-9;   // of other rows' norms: no camera

[[noreturn]] void fail(const std::string& where, const std::string& what)
{
  throw std::runtime_error(where + ": " + what);
}

template <typename... Parts>
std::string sentence(const Parts&... parts)
{
  std::ostringstream text;
  (text << ... << parts);
  return text.str();
}

std::string listOf(const Eigen::VectorXd& vector)
{
  std::ostringstream text;
  text << vector.format(Eigen::IOFormat(6, Eigen::DontAlignCols, ", ", ", "));
  return "[" + text.str() + "]";
}

/// A place [mm], without what rounding leaves of zeros.
std::string placeOf(const Eigen::Vector3d& mm)
{
  return listOf(((mm.array() * 1e6).round() / 1e6 + 0.0).matrix());
}

/// A view's matrix taken apart. Left-handed if axes' determinant is -1.
struct Camera
{
  Eigen::Vector3d source;
  Eigen::Matrix3d axes;  ///< rows: along columns, along rows, from the source to the panel
  Eigen::Vector2d focal_length, foot;
  double skew = 0.0;  ///< px at the image's edge
};

bool isPixelOf(const ImportedView& view, const Eigen::Vector3d& point)
{
  const Eigen::Vector3d p = view.matrix * point.homogeneous();
  const Eigen::Array2d pixel = p.head<2>() / p.z();
  return pixel.allFinite() && (pixel >= -0.5).all() && (pixel <= view.image_size.cast<double>().array() - 0.5).all();
}

/// The matrix' sign is to be right.
Camera cameraOf(const ImportedView& view)
{
  const Eigen::Matrix3d m = view.matrix.leftCols<3>() / view.matrix.row(2).head<3>().norm();
  Camera camera;
  const Eigen::Vector3d normal = m.row(2);
  camera.foot = m.topRows<2>() * normal;
  Eigen::Vector3d along_rows = m.row(1).transpose() - camera.foot.y() * normal;
  camera.focal_length.y() = along_rows.norm();
  along_rows /= camera.focal_length.y();
  Eigen::Vector3d along_columns = m.row(0).transpose() - camera.foot.x() * normal;
  const double skew = along_columns.dot(along_rows);
  along_columns -= skew * along_rows;
  camera.focal_length.x() = along_columns.norm();
  along_columns /= camera.focal_length.x();
  camera.axes << along_columns.transpose(), along_rows.transpose(), normal.transpose();
  camera.source = -view.matrix.leftCols<3>().inverse() * view.matrix.col(3);
  const double edge = std::max(std::abs(camera.foot.y()), std::abs(view.image_size.y() - 1.0 - camera.foot.y()));
  camera.skew = std::abs(skew) * edge / camera.focal_length.y();
  return camera;
}

/// The rest of the import takes inverses.
void checkMatrix(const ImportedView& view)
{
  const Eigen::Matrix3d m = view.matrix.leftCols<3>();
  const double last = m.row(2).norm();
  if (!view.matrix.allFinite() || !(last > kNoMatrix * view.matrix.topLeftCorner<2, 3>().norm()))
  {
    fail(view.where, "the third row of the matrix begins with " + listOf(m.row(2)) +
                         ": expected the direction from the source to the panel; parallel rays have none");
  }
  const Camera camera = cameraOf(view);
  if (!camera.source.allFinite() || !(camera.focal_length.array() > kNoMatrix * (1.0 + camera.foot.norm())).all())
  {
    fail(view.where, "the matrix " +
                         listOf(Eigen::Map<const Eigen::VectorXd>(
                             Eigen::Matrix<double, 4, 3>(view.matrix.transpose()).data(), 12)) +
                         " is no camera's: expected rows that are independent in their first three columns");
  }
  if (!(camera.skew <= kMaxSkew))
  {
    fail(view.where,
         sentence("its pixels are skewed, by ", camera.skew,
                  " px at the image's edge: expected columns and rows at right angles, to ", kMaxSkew, " px"));
  }
}

std::string readText(const std::string& path)
{
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
  {
    fail(path, "missing or not a file");
  }
  std::ifstream file(path, std::ios::binary);
  if (!file)
  {
    fail(path, "not readable");
  }
  std::string text(std::min<std::uintmax_t>(std::filesystem::file_size(path), kMaxTextSize), '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(file.gcount()));
  return text;
}

std::vector<ImportedView> readViews(const std::string& path, const GeometryImportOptions& options)
{
  const std::string text = readText(path);
  if (text.size() > 132 && text.compare(128, 4, "DICM") == 0)
  {
    return readDicomGeometry(path, options);
  }
  const std::vector<TextLine> lines = linesOf(path, text);
  if (lines.empty())
  {
    fail(path, "is empty: expected MayaCam 2.0, 3 x 4 matrices, RTK's geometry, DICOM, or YAML with detectors");
  }
  const std::string& first = lines.front().text;
  if (first.front() == '<')
  {
    return readRtkGeometry(path, text, options);
  }
  const auto is_heading = [](const TextLine& line)
  {
    const char* const kHeadings[] = { "image size", "camera matrix", "rotation", "translation" };
    return std::any_of(std::begin(kHeadings), std::end(kHeadings),
                       [&](const char* heading)
                       {
                         const std::string wanted = heading;
                         return line.text.size() == wanted.size() &&
                                std::equal(wanted.begin(), wanted.end(), line.text.begin(),
                                           [](char a, char b) { return a == std::tolower(b); });
                       });
  };
  if (std::any_of(lines.begin(), lines.end(), is_heading))
  {
    return readMayaCam(path, text, options);
  }
  if (std::any_of(lines.begin(), lines.end(), [](const TextLine& line) { return line.text.find("detectors:") == 0; }))
  {
    return readDetectorList(path, options);
  }
  if (std::string("0123456789+-.[({#").find(first.front()) != std::string::npos)
  {
    return readMatrices(path, text, options);
  }
  fail(lines.front().where, quoted(first) +
                                ": expected MayaCam 2.0 (\"image size\"), 3 x 4 matrices, RTK's geometry (XML), DICOM "
                                "with its preamble, or YAML with detectors");
}

/// The tangential coefficient (p1: 2, p2: 3) of an image that was flipped along its axis.
void turnTangential(DistortionCoefficients& distortion, std::size_t index)
{
  if (!distortion.model.empty())
  {
    distortion.values[index] = -distortion.values[index];
  }
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
  if (camera.skew > kTellSkew)
  {
    text << "; a skew of " << camera.skew << " px at the image's edge is left out";
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
}  // namespace

std::string implausibility(const ProjectionGeometry& detector, const Eigen::Vector3d& patient)
{
  const double depth = detector.depth(patient);
  const double sdd = detector.sourceToDetector();
  const Eigen::Array2d sides = detector.imageSize().cast<double>().cwiseProduct(detector.pixelPitch());
  const auto unit = [](double distance)
  {
    const auto is_room = [&](double factor) { return distance * factor >= 300.0 && distance * factor <= 6000.0; };
    return is_room(1000.0) ? "; are coordinates in metres?" : is_room(10.0) ? "; are coordinates in centimetres?" : "";
  };
  if (!(sdd >= kNearest && sdd <= kFarthestPanel && sides.minCoeff() >= kSmallest && sides.maxCoeff() <= kLargest))
  {
    const std::string what =
        sentence("the panel is ", sides.x(), " x ", sides.y(), " mm, ", sdd, " mm from the source: expected sides of ",
                 kSmallest, " to ", kLargest, " mm, ", kNearest, " to ", kFarthestPanel, " mm from it", unit(sdd));
    return what + (sdd > kFarthestPanel || sides.maxCoeff() > kLargest ? "; is the pitch in mm?" : "");
  }
  if (!(depth > 0.0))
  {
    return sentence("the source, at ", placeOf(detector.source()), " mm, is ", -depth,
                    " mm beyond the patient, as the panel has it: expected it to face him; are source and panel "
                    "swapped, or is the patient elsewhere?");
  }
  if (!(depth >= kNearest && depth <= kFarthest))
  {
    return sentence("the source, at ", placeOf(detector.source()), " mm, is ", depth, " mm from the patient: expected ",
                    kNearest, " to ", kFarthest, " mm", unit(depth));
  }
  if (!(sdd > depth))
  {
    return sentence("the panel is ", sdd, " mm from the source, nearer than the patient, at ", depth,
                    " mm: expected it beyond him; are source and panel swapped? Or is the pitch too small: with these "
                    "focal lengths more than ",
                    depth / detector.focalLength().x(), " mm?");
  }
  return "";
}

namespace
{
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

ImportedView viewOf(const DetectorDescription& description, const std::string& where)
{
  ImportedView view;
  view.where = where;
  view.image_size = description.image_size;
  view.pixel_pitch = description.pixel_pitch;
  view.front_is_known = true;
  Eigen::Vector3d normal = description.x_direction.cross(description.y_direction).normalized();
  Eigen::Vector3d origin = description.origin - description.source;
  if (origin.dot(normal) < 0.0)
  {
    normal = -normal;
  }
  const double sdd = origin.dot(normal);
  if (!(sdd >= kLeastDistance))
  {
    fail(where, "the source is at " + placeOf(description.source) + ", " + sentence(sdd) +
                    " mm from the panel's plane: expected a distance");
  }
  const Eigen::Vector2d foot =
      -Eigen::Vector2d(origin.dot(description.x_direction), origin.dot(description.y_direction))
           .cwiseQuotient(description.pixel_pitch);
  Eigen::Matrix3d camera = Eigen::Matrix3d::Identity();
  camera.diagonal().head<2>() = sdd * description.pixel_pitch.cwiseInverse();
  camera.topRightCorner<2, 1>() = foot;
  Eigen::Matrix3d axes;
  axes << description.x_direction.transpose(), description.y_direction.transpose(), normal.transpose();
  view.matrix << camera * axes, -camera * axes * description.source;
  return view;
}

void refuseOptions(const std::string& path, const std::vector<std::pair<const char*, bool>>& given)
{
  for (const auto& [name, is_given] : given)
  {
    if (is_given)
    {
      throw std::invalid_argument(std::string(name) + ": " + path + " says it itself, or has no use for it");
    }
  }
}

Eigen::Vector2i imageSizeOf(const GeometryImportOptions& options, const std::string& path)
{
  if (!options.image_size)
  {
    throw std::invalid_argument(path + " has no image size: expected --image_size COLUMNS ROWS");
  }
  return *options.image_size;
}

Eigen::Vector2d pixelPitchOf(const GeometryImportOptions& options, const std::string& path)
{
  if (!options.pixel_pitch)
  {
    throw std::invalid_argument(path + " has no pixel pitch: expected --pitch MM");
  }
  return *options.pixel_pitch;
}

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
    throw std::invalid_argument(sentence(views.size(), " view in the files: expected two or more"));
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
    RigidTransform room_from_optical = RigidTransform::Identity();
    room_from_optical.linear() = camera.axes.transpose();
    room_from_optical.translation() = camera.source;
    imported.detectors.push_back(ProjectionGeometry::fromIntrinsics(view.name, view.image_size, camera.focal_length,
                                                                    camera.foot, room_from_optical, sdd));
    const ProjectionGeometry& detector = imported.detectors.back();
    const std::string doubt = point ? implausibility(detector, *point) : "";
    if (!doubt.empty() && !options.unit)  // which says that they are right
    {
      fail(view.where, doubt + (view.is_in_mm ? "" : ". Then give --unit m or cm; if they are right, --unit mm"));
    }
    imported.distortions.push_back(view.distortion);
    if (!view.distortion.model.empty())
    {
      LensDistortion(view.distortion.model, view.distortion.values, detector);  // refuses what is of no use
    }
    imported.remarks.push_back(remarkOf(view, detector, camera, point));
  }
  imported.point = point;
  imported.remarks.push_back(point ? "all views see " + placeOf(*point) + " mm"
                                   : "no room point is in the middle of all images: do the views belong together?");
  return imported;
}

void writeDetectors(const ImportedGeometry& geometry, const std::string& path, const std::string& into)
{
  namespace fs = std::filesystem;
  YAML::Node root;
  if (!into.empty())
  {
    try
    {
      root = YAML::LoadFile(into);
    }
    catch (const YAML::Exception& error)
    {
      fail(into, std::string("missing or not YAML: ") + error.what());
    }
    if (!root.IsMap())
    {
      fail(into, "expected keys with values");
    }
    const fs::path folder = fs::absolute(into).parent_path();
    if (folder != fs::absolute(path).parent_path())
    {
      for (const char* const key : { "ct", "frames", "gold_standard" })
      {
        if (root[key] && root[key].IsScalar())
        {
          root[key] = (folder / root[key].Scalar()).lexically_normal().string();
        }
      }
    }
  }
  YAML::Node list;
  for (std::size_t n = 0; n < geometry.detectors.size(); ++n)
  {
    YAML::Node detector = detectorNode(geometry.detectors[n]);
    if (!geometry.distortions[n].model.empty())
    {
      detector["distortion"]["model"] = geometry.distortions[n].model;
      detector["distortion"]["coefficients"] = geometry.distortions[n].values;
      detector["distortion"].SetStyle(YAML::EmitterStyle::Flow);
    }
    list.push_back(detector);
  }
  root["detectors"] = list;
  std::ofstream file(path);
  file << root << "\n";
  file.close();
  if (!file)
  {
    fail(path, "cannot be written");
  }
}
}  // namespace xray_tracking
