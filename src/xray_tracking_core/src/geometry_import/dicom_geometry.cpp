#include <cmath>
#include <map>
#include <optional>
#include <sstream>
#include <stdexcept>

#include <Eigen/Geometry>
#include <boost/math/constants/constants.hpp>

#include "../volume/dicom_file.h"
#include "imported_view.h"

namespace xray_tracking
{
namespace
{
constexpr double kSameMagnification = 0.05;
constexpr double kDegree = boost::math::constants::degree<double>();
constexpr double kLevel = 0.1;          // degrees of tilt that are none
constexpr double kSamePlane = 1.0;      // mm
constexpr double kUnitNorm = 1e-3;      // of direction cosines
constexpr double kSameDirection = 0.5;  // cosine: letters tell 45 degrees

const std::map<std::string, gdcm::Tag> kTags{
  { "Modality", { 0x0008, 0x0060 } },
  { "DistanceSourceToDetector", { 0x0018, 0x1110 } },
  { "DistanceSourceToPatient", { 0x0018, 0x1111 } },
  { "ImagerPixelSpacing", { 0x0018, 0x1164 } },
  { "EstimatedRadiographicMagnificationFactor", { 0x0018, 0x1114 } },
  { "PositionerMotion", { 0x0018, 0x1500 } },
  { "PositionerType", { 0x0018, 0x1508 } },
  { "PositionerPrimaryAngle", { 0x0018, 0x1510 } },
  { "PositionerSecondaryAngle", { 0x0018, 0x1511 } },
  { "DetectorPrimaryAngle", { 0x0018, 0x1530 } },
  { "DetectorSecondaryAngle", { 0x0018, 0x1531 } },
  { "FieldOfViewRotation", { 0x0018, 0x7032 } },
  { "FieldOfViewHorizontalFlip", { 0x0018, 0x7034 } },
  { "PatientOrientation", { 0x0020, 0x0020 } },
  { "NumberOfFrames", { 0x0028, 0x0008 } },
  { "Rows", { 0x0028, 0x0010 } },
  { "Columns", { 0x0028, 0x0011 } },
  { "RTImagePlane", { 0x3002, 0x000c } },
  { "XRayImageReceptorTranslation", { 0x3002, 0x000d } },
  { "XRayImageReceptorAngle", { 0x3002, 0x000e } },
  { "RTImageOrientation", { 0x3002, 0x0010 } },
  { "ImagePlanePixelSpacing", { 0x3002, 0x0011 } },
  { "RTImagePosition", { 0x3002, 0x0012 } },
  { "RadiationMachineSAD", { 0x3002, 0x0022 } },
  { "RTImageSID", { 0x3002, 0x0026 } },
  { "GantryAngle", { 0x300a, 0x011e } },
  { "GantryPitchAngle", { 0x300a, 0x014a } },
};

/// Attributes by name, that messages may have it.
class Attributes
{
public:
  explicit Attributes(const std::string& path) : path_(path), header_(readDicomHeader(path))
  {
    if (!header_)
    {
      fail("not readable or truncated");
    }
    if (!header_->fault.empty())
    {
      fail(header_->fault);
    }
  }

  [[noreturn]] void fail(const std::string& what) const { throw std::runtime_error(path_ + ": " + what); }

  const std::string& path() const { return path_; }
  bool has(const std::string& name) const { return !text(name).empty() || !header_->data.numbers(tag(name)).empty(); }
  std::string text(const std::string& name) const { return header_->data.text(tag(name)); }

  /// Nothing if it is absent or empty. @throws if these are not `count` finite numbers
  std::optional<std::vector<double>> numbers(const std::string& name, std::size_t count) const
  {
    if (!has(name))
    {
      return std::nullopt;
    }
    const std::vector<double> values = header_->data.numbers(tag(name));
    bool good = values.size() == count;
    for (const double value : values)
    {
      good = good && std::abs(value) < 1e9;
    }
    if (!good)
    {
      fail(name + " is \"" + text(name) + "\": expected " + std::to_string(count) +
           (count == 1 ? " finite number" : " finite numbers"));
    }
    return values;
  }

  double number(const std::string& name) const
  {
    const auto value = numbers(name, 1);
    if (!value)
    {
      fail(name + " is absent or empty: expected a number");
    }
    return value->front();
  }

  double numberOr(const std::string& name, double otherwise) const
  {
    const auto value = numbers(name, 1);
    return value ? value->front() : otherwise;
  }

  double distance(const std::string& name) const
  {
    const double value = number(name);
    if (!(value > 0.0))
    {
      fail(name + " is " + text(name) + ": expected a positive distance");
    }
    return value;
  }

  /// Spacings are between rows, between columns: pitch along columns, along rows.
  Eigen::Vector2d pitch(const std::string& name) const
  {
    const std::vector<double> spacing = *numbers(name, 2);
    if (!(spacing[0] > 0.0 && spacing[1] > 0.0))
    {
      fail(name + " is " + text(name) + ": expected two positive numbers");
    }
    return { spacing[1], spacing[0] };
  }

  void requireLevel(const std::string& name) const
  {
    const double angle = numberOr(name, 0.0);
    if (!(std::abs(angle) <= kLevel))
    {
      std::ostringstream what;
      what << name << " is " << angle << " degrees: expected 0, where this has no part";
      fail(what.str());
    }
  }

private:
  static const gdcm::Tag& tag(const std::string& name) { return kTags.at(name); }

  std::string path_;
  std::optional<DicomHeader> header_;
};

/// Direction of PatientOrientation's letters, LPS; zero if there are others.
Eigen::Vector3d directionOf(const std::string& letters)
{
  static const std::map<char, Eigen::Vector3d> kLetters{
    { 'L', { 1, 0, 0 } },  { 'R', { -1, 0, 0 } }, { 'P', { 0, 1, 0 } },
    { 'A', { 0, -1, 0 } }, { 'H', { 0, 0, 1 } },  { 'F', { 0, 0, -1 } },
  };
  // The first letter says most.
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  double weight = 1.0;
  for (const char letter : letters)
  {
    const auto found = kLetters.find(letter);
    if (found == kLetters.end())
    {
      return Eigen::Vector3d::Zero();
    }
    direction += weight * found->second;
    weight *= 0.5;
  }
  return direction.norm() > 0.0 ? direction.normalized() : direction;
}

/// Of LPS axes through the isocentre: as the geometry presets lay a supine patient, head first (docs/frames.md).
Eigen::Vector3d roomFromPatientAxes(const Eigen::Vector3d& lps)
{
  return { lps.z(), -lps.x(), -lps.y() };
}

/// Of IEC 61217's fixed system (docs/frames.md).
Eigen::Vector3d roomFromIecFixed(const Eigen::Vector3d& fixed)
{
  return { fixed.y(), -fixed.x(), fixed.z() };
}

DetectorDescription descriptionOf(const Attributes& file, const Eigen::Vector2d& pitch)
{
  DetectorDescription description;
  description.image_size = Eigen::Vector2d(file.distance("Columns"), file.distance("Rows")).cast<int>();
  description.pixel_pitch = pitch;
  return description;
}

/// DICOM PS3.3 C.8.7.5, XA positioner: the detector about the patient, the isocentre in the image's middle, which is
/// shown heads up as seen from the detector; PatientOrientation may say otherwise.
ImportedView positionerView(const Attributes& file, const GeometryImportOptions& options)
{
  if (file.text("PositionerMotion") == "DYNAMIC")
  {
    file.fail("PositionerMotion is DYNAMIC: expected STATIC, one place of the detector");
  }
  if (const std::string type = file.text("PositionerType"); !type.empty() && type != "CARM")
  {
    file.fail("PositionerType is " + type + ": expected CARM, whose angles are those of a source about the patient");
  }
  file.requireLevel("DetectorPrimaryAngle");
  file.requireLevel("DetectorSecondaryAngle");
  const double primary = file.number("PositionerPrimaryAngle") * kDegree;
  const double secondary = file.number("PositionerSecondaryAngle") * kDegree;
  const double sdd = file.distance("DistanceSourceToDetector");
  const double sid = file.distance("DistanceSourceToPatient");
  if (sid >= sdd)
  {
    file.fail("DistanceSourceToPatient is " + file.text("DistanceSourceToPatient") + ", DistanceSourceToDetector " +
              file.text("DistanceSourceToDetector") + ": expected the detector beyond the patient; are they swapped?");
  }
  const double magnification = file.numberOr("EstimatedRadiographicMagnificationFactor", sdd / sid);
  if (!(std::abs(magnification * sid / sdd - 1.0) <= kSameMagnification))
  {
    std::ostringstream what;
    what << "EstimatedRadiographicMagnificationFactor is " << magnification << ", but the distances from the source, "
         << sid << " and " << sdd << " mm, make " << sdd / sid << ": expected the same to 5 %";
    file.fail(what.str());
  }
  const bool is_turned =
      file.numberOr("FieldOfViewRotation", 0.0) != 0.0 || file.text("FieldOfViewHorizontalFlip") == "YES";
  if (is_turned && file.text("PatientOrientation").empty())
  {
    file.fail(
        "FieldOfViewRotation or FieldOfViewHorizontalFlip says that the image is turned, and PatientOrientation is "
        "absent: expected one of them alone to say how it lies");
  }
  // Left, posterior, superior: detector in front of the patient at 0, 0, at his left at 90, at his head at
  // secondary 90.
  const Eigen::Vector3d to_detector(std::sin(primary) * std::cos(secondary), -std::cos(primary) * std::cos(secondary),
                                    std::sin(secondary));
  const Eigen::Vector3d up(-std::sin(primary) * std::sin(secondary), std::cos(primary) * std::sin(secondary),
                           std::cos(secondary));
  Eigen::Vector3d along_row = -to_detector.cross(up);
  Eigen::Vector3d along_column = -up;

  const std::string orientation = file.text("PatientOrientation");
  const auto backslash = orientation.find('\\');
  if (!orientation.empty())
  {
    const double row_cosine = directionOf(orientation.substr(0, backslash)).dot(along_row);
    const double column_cosine =
        backslash == std::string::npos ? 0.0 : directionOf(orientation.substr(backslash + 1)).dot(along_column);
    if (!(std::abs(row_cosine) > kSameDirection && std::abs(column_cosine) > kSameDirection))
    {
      std::ostringstream what;
      what << "PatientOrientation is " << orientation << ", which does not fit PositionerPrimaryAngle "
           << primary / kDegree << " and PositionerSecondaryAngle " << secondary / kDegree
           << ": expected an image with the head up, or turned by half, as it is seen from there";
      file.fail(what.str());
    }
    along_row *= row_cosine > 0.0 ? 1.0 : -1.0;
    along_column *= column_cosine > 0.0 ? 1.0 : -1.0;
  }

  const bool has_pitch = file.has("ImagerPixelSpacing");
  refuseOptions(file.path(), { { "--pitch", has_pitch && options.pixel_pitch } });
  if (!has_pitch && !options.pixel_pitch)
  {
    file.fail(
        "ImagerPixelSpacing is absent: expected the pitch on the detector; give --pitch (PixelSpacing may be that "
        "in the patient)");
  }
  DetectorDescription description =
      descriptionOf(file, has_pitch ? file.pitch("ImagerPixelSpacing") : *options.pixel_pitch);
  description.source = roomFromPatientAxes(-sid * to_detector);
  description.x_direction = roomFromPatientAxes(along_row);
  description.y_direction = roomFromPatientAxes(along_column);
  const Eigen::Vector2d half =
      0.5 * (description.image_size.cast<double>().array() - 1.0).matrix().cwiseProduct(description.pixel_pitch);
  description.origin = roomFromPatientAxes((sdd - sid) * to_detector) - half.x() * description.x_direction -
                       half.y() * description.y_direction;
  ImportedView view = viewOf(description, file.path());
  view.is_in_mm = true;
  view.flip = "columns";
  view.hint = "DICOM shows XA images as they are seen from the detector, looking towards the source";
  return view;
}

/// IEC 61217: receptor in gantry in fixed system. RTImageSID is where the image plane is, ImagePlanePixelSpacing the
/// pitch there.
ImportedView rtImageView(const Attributes& file)
{
  if (!file.text("RTImagePlane").empty() && file.text("RTImagePlane") != "NORMAL")
  {
    file.fail("RTImagePlane is " + file.text("RTImagePlane") + ": expected NORMAL, at right angles to the beam's axis");
  }
  file.requireLevel("GantryPitchAngle");
  const double sid = file.distance("RTImageSID");
  const double sad = file.distance("RadiationMachineSAD");
  if (sad >= sid)
  {
    file.fail("RTImageSID is " + file.text("RTImageSID") + ", RadiationMachineSAD " + file.text("RadiationMachineSAD") +
              ": expected the image plane beyond the isocentre; are they swapped?");
  }
  if (!file.has("ImagePlanePixelSpacing"))
  {
    file.fail("ImagePlanePixelSpacing is absent: expected the pitch in the image plane");
  }
  const std::vector<double> translation =
      file.numbers("XRayImageReceptorTranslation", 3).value_or(std::vector<double>{ 0.0, 0.0, sad - sid });
  const bool is_offset = translation[0] != 0.0 || translation[1] != 0.0;
  if (is_offset && !(std::abs(translation[2] - (sad - sid)) <= kSamePlane))
  {
    std::ostringstream what;
    what << "XRayImageReceptorTranslation is " << translation[0] << "\\" << translation[1] << "\\" << translation[2]
         << ", but RTImageSID " << sid << " and RadiationMachineSAD " << sad << " put the image plane at " << sad - sid
         << ": expected the same, as the offsets would be of another plane";
    file.fail(what.str());
  }
  const Eigen::Matrix3d fixed_from_receptor =
      (Eigen::AngleAxisd(file.number("GantryAngle") * kDegree, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(file.numberOr("XRayImageReceptorAngle", 0.0) * kDegree, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  const Eigen::Matrix3d fixed_from_gantry =
      Eigen::AngleAxisd(file.number("GantryAngle") * kDegree, Eigen::Vector3d::UnitY()).toRotationMatrix();

  const std::vector<double> cosines =
      file.numbers("RTImageOrientation", 6).value_or(std::vector<double>{ 1.0, 0.0, 0.0, 0.0, -1.0, 0.0 });
  const Eigen::Vector3d row(cosines.data());
  const Eigen::Vector3d column(cosines.data() + 3);
  if (std::abs(row.norm() - 1.0) > kUnitNorm || std::abs(column.norm() - 1.0) > kUnitNorm ||
      std::abs(row.dot(column)) > kUnitNorm || std::abs(row.z()) > kUnitNorm || std::abs(column.z()) > kUnitNorm)
  {
    file.fail("RTImageOrientation is " + file.text("RTImageOrientation") +
              ": expected two unit vectors at right angles in the receptor's plane, as 1\\0\\0\\0\\-1\\0");
  }

  DetectorDescription description = descriptionOf(file, file.pitch("ImagePlanePixelSpacing"));
  const Eigen::Vector2d half =
      0.5 * (description.image_size.cast<double>().array() - 1.0).matrix().cwiseProduct(description.pixel_pitch);
  Eigen::Vector3d corner = -half.x() * row - half.y() * column;
  if (const auto position = file.numbers("RTImagePosition", 2))
  {
    corner = Eigen::Vector3d((*position)[0], (*position)[1], 0.0);
  }
  const Eigen::Vector3d receptor(translation[0], translation[1], sad - sid);
  description.source = roomFromIecFixed(fixed_from_gantry * Eigen::Vector3d(0.0, 0.0, sad));
  description.origin = roomFromIecFixed(fixed_from_gantry * receptor + fixed_from_receptor * corner);
  description.x_direction = roomFromIecFixed(fixed_from_receptor * row).normalized();
  description.y_direction = roomFromIecFixed(fixed_from_receptor * column).normalized();
  ImportedView view = viewOf(description, file.path());
  view.is_in_mm = true;
  view.flip = "rows";
  view.hint = "RTImageOrientation is " + file.text("RTImageOrientation") + ", and IEC's receptor looks at the source";
  return view;
}
}  // namespace

std::vector<ImportedView> readDicomGeometry(const std::string& path, const GeometryImportOptions& options)
{
  refuseOptions(path, { { "--image_size", options.image_size.has_value() },
                        { "--sdd", options.source_to_detector.has_value() },
                        { "--unit", options.unit.value_or(1.0) != 1.0 },
                        { "--projections", !options.projections.empty() } });
  const Attributes file(path);
  if (file.numberOr("NumberOfFrames", 1.0) > 1.0)
  {
    file.fail("NumberOfFrames is " + file.text("NumberOfFrames") + ": expected 1");
  }
  const std::string modality = file.text("Modality");
  if (modality == "RTIMAGE")
  {
    refuseOptions(path, { { "--pitch", options.pixel_pitch.has_value() } });
    return { rtImageView(file) };
  }
  if (modality != "XA" && modality != "RF" && modality != "DX" && modality != "CR")
  {
    file.fail("Modality is " + (modality.empty() ? "absent" : modality) + ": expected XA, RF, DX, CR or RTIMAGE");
  }
  return { positionerView(file, options) };
}
}  // namespace xray_tracking
