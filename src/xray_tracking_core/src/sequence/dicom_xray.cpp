#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "../volume/dicom_file.h"
#include "../volume/short_uids.h"
#include "xray_formats.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kImagerPixelSpacing(0x0018, 0x1164);
const gdcm::Tag kRows(0x0028, 0x0010);
const gdcm::Tag kColumns(0x0028, 0x0011);
const gdcm::Tag kRelationship(0x0028, 0x1040);
const gdcm::Tag kRelationshipSign(0x0028, 0x1041);
const gdcm::Tag kIntercept(0x0028, 0x1052);
const gdcm::Tag kSlope(0x0028, 0x1053);
const gdcm::Tag kModalityLut(0x0028, 0x3000);

/// Below it, rounding to whole numbers would take what the image shows.
constexpr double kLeastSlope = 0.1;
/// Of spacings: tags and setups are rounded.
constexpr double kSameSpacing = 0.01;

[[noreturn]] void fail(const std::string& path, const std::string& what)
{
  throw std::runtime_error(withShortUids(path + ": " + what));
}

void checkSpacing(const DicomData& header, const ProjectionGeometry& detector, const std::string& path)
{
  const std::vector<double> spacing = header.numbers(kImagerPixelSpacing);  // between rows, between columns
  if (spacing.size() != 2)
  {
    return;  // PixelSpacing is that of the patient as often as that of the detector
  }
  const Eigen::Vector2d& pitch = detector.pixelPitch();
  if (!(std::abs(spacing[1] - pitch.x()) <= kSameSpacing * pitch.x() &&
        std::abs(spacing[0] - pitch.y()) <= kSameSpacing * pitch.y()))
  {
    std::ostringstream message;
    message << "ImagerPixelSpacing is " << spacing[0] << "\\" << spacing[1] << " mm, but pixel_pitch_mm of "
            << detector.name() << " is " << pitch.x() << " " << pitch.y()
            << ": expected the same; was the image binned? (If only focal lengths in pixels are known, multiply the "
               "detector's pitch and its distance from the source alike: it is the same camera.)";
    fail(path, message.str());
  }
}

void checkRelationship(const DicomData& header, IntensityModel::Kind kind, const std::string& path)
{
  const bool counts = kind == IntensityModel::Kind::COUNTS;
  const std::string relationship = header.text(kRelationship);
  const std::string expected =
      counts ? ": kind: counts expects LIN (or DISP) and 1" : ": kind: attenuation expects LOG and -1";
  if (!relationship.empty() && (counts ? relationship != "LIN" && relationship != "DISP" : relationship != "LOG"))
  {
    fail(path, "PixelIntensityRelationship is " + relationship + expected);
  }
  const std::optional<double> sign = header.number(kRelationshipSign);
  if (sign && *sign != (counts ? 1.0 : -1.0))
  {
    fail(path, std::string("PixelIntensityRelationshipSign is ") +
                   (*sign < 0.0 ? "-1, higher values for fewer X-rays" : "1, higher values for more X-rays") +
                   expected);
  }
}
}  // namespace

cv::Mat readDicomXray(const std::string& path, const ProjectionGeometry& detector, IntensityModel::Kind kind)
{
  const std::optional<DicomHeader> file = readDicomHeader(path);
  if (!file)
  {
    fail(path, "not readable or truncated");
  }
  if (!file->fault.empty())
  {
    fail(path, file->fault);
  }
  const DicomData& header = file->data;
  checkRelationship(header, kind, path);
  if (header.has(kModalityLut))
  {
    fail(path, "has a ModalityLUTSequence, expected RescaleSlope and RescaleIntercept, or neither");
  }
  const auto size_of = [&](const gdcm::Tag& tag)
  { return static_cast<std::uint32_t>(std::min(std::max(0.0, header.number(tag).value_or(0.0)), 1e6)); };
  requireSize(path, size_of(kColumns), size_of(kRows), detector);
  const DicomPixels pixels(path);
  if (pixels.frames() != 1)
  {
    fail(path, "NumberOfFrames is " + std::to_string(pixels.frames()) + ", expected 1: a file for each exposure");
  }
  double slope = header.has(kSlope) ? header.number(kSlope).value_or(NAN) : 1.0;
  double intercept = header.has(kIntercept) ? header.number(kIntercept).value_or(NAN) : 0.0;
  if (!std::isfinite(slope) || !std::isfinite(intercept) || slope == 0.0)
  {
    fail(path, "RescaleSlope is \"" + header.text(kSlope) + "\", RescaleIntercept \"" + header.text(kIntercept) +
                   "\", expected finite numbers, and a slope that is not 0");
  }
  if (std::abs(slope) < kLeastSlope)
  {
    intercept /= std::abs(slope);
    slope = slope < 0.0 ? -1.0 : 1.0;
  }
  std::vector<std::int32_t> stored;
  pixels.read(0, stored);
  cv::Mat values(pixels.rows(), pixels.columns(), CV_64FC1);
  for (std::size_t n = 0; n < stored.size(); ++n)
  {
    values.ptr<double>()[n] = std::round(slope * stored[n] + intercept);
  }
  checkSpacing(header, detector, path);
  return values;
}
}  // namespace xray_tracking
