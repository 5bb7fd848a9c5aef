#include "dicom_series.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <tuple>
#include <utility>

#include "ct_error.h"
#include "dicom_file.h"
#include "xray_tracking_core/volume/ct_frame.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kImageType(0x0008, 0x0008);
const gdcm::Tag kSopClass(0x0008, 0x0016);
const gdcm::Tag kModality(0x0008, 0x0060);
const gdcm::Tag kFrameType(0x0008, 0x9007);
const gdcm::Tag kAnatomicalOrientationType(0x0010, 0x2210);
const gdcm::Tag kCtFrameType(0x0018, 0x9329);
const gdcm::Tag kSeriesUid(0x0020, 0x000e);
const gdcm::Tag kPosition(0x0020, 0x0032);
const gdcm::Tag kOrientation(0x0020, 0x0037);
const gdcm::Tag kFrameOfReference(0x0020, 0x0052);
const gdcm::Tag kFrameContent(0x0020, 0x9111);
const gdcm::Tag kPlanePosition(0x0020, 0x9113);
const gdcm::Tag kPlaneOrientation(0x0020, 0x9116);
const gdcm::Tag kSamplesPerPixel(0x0028, 0x0002);
const gdcm::Tag kFrames(0x0028, 0x0008);
const gdcm::Tag kRows(0x0028, 0x0010);
const gdcm::Tag kColumns(0x0028, 0x0011);
const gdcm::Tag kPixelSpacing(0x0028, 0x0030);
const gdcm::Tag kPixelPadding(0x0028, 0x0120);
const gdcm::Tag kPixelPaddingLimit(0x0028, 0x0121);
const gdcm::Tag kIntercept(0x0028, 0x1052);
const gdcm::Tag kSlope(0x0028, 0x1053);
const gdcm::Tag kRescaleType(0x0028, 0x1054);
const gdcm::Tag kModalityLut(0x0028, 0x3000);
const gdcm::Tag kPixelMeasures(0x0028, 0x9110);
const gdcm::Tag kPixelValueTransformation(0x0028, 0x9145);
const gdcm::Tag kSharedGroups(0x5200, 0x9229);
const gdcm::Tag kPerFrameGroups(0x5200, 0x9230);

/// What may tell volumes apart that have one SeriesInstanceUID, the surest first.
const std::vector<std::pair<const char*, gdcm::Tag>> kTraits{
  { "AcquisitionNumber", { 0x0020, 0x0012 } },
  { "FrameAcquisitionNumber", { 0x0020, 0x9156 } },
  { "TemporalPositionIdentifier", { 0x0020, 0x0100 } },
  { "TemporalPositionIndex", { 0x0020, 0x9128 } },
  { "StackID", { 0x0020, 0x9056 } },
  { "NominalPercentageOfCardiacPhase", { 0x0020, 0x9241 } },
  { "ConvolutionKernel", { 0x0018, 0x1210 } },
  { "KVP", { 0x0018, 0x0060 } },
  { "ContrastBolusAgent", { 0x0018, 0x0010 } },
  { "ReconstructionDiameter", { 0x0018, 0x1100 } },
  { "SliceThickness", { 0x0018, 0x0050 } },
  { "ImageType", { 0x0008, 0x0008 } },
  { "SeriesDescription", { 0x0008, 0x103e } },
  { "AcquisitionDateTime", { 0x0008, 0x002a } },
  { "AcquisitionDate", { 0x0008, 0x0022 } },
  { "AcquisitionTime", { 0x0008, 0x0032 } },
  { "ContentTime", { 0x0008, 0x0033 } },
};

/// Those whose values are dates, or words that somebody typed: they are numbered, as labels go to logs and into setups.
const std::set<std::string> kNumbered{ "ContrastBolusAgent", "SeriesDescription", "AcquisitionDateTime",
                                       "AcquisitionDate" };

/// Directions are written with few decimals.
constexpr double kDirectionTolerance = 1e-3;
// Of pixels, from micro-CT to a scout [mm].
constexpr double kLeastSpacing = 0.01;
constexpr double kMostSpacing = 20.0;
/// Share of the slice distance by which a slice may be off its place, besides what its position is rounded by.
constexpr double kPlaceTolerance = 0.05;
/// Rounding allowed for is at most this share of the slice distance: a missing slice must show.
constexpr double kMostRounding = 0.3;
/// Of one file; more would be a spine in steps of 0.05 mm.
constexpr int kMostFrames = 20000;
/// Fewer slices than this are no volume where there is something larger.
constexpr std::size_t kFewSlices = 4;

struct Slice
{
  std::string file;
  int frame = 0;
  Eigen::Vector2i size;         ///< columns, rows
  Eigen::Vector2d spacing;      ///< between columns, between rows [mm]
  Eigen::Vector3d x_direction;  ///< along growing columns
  Eigen::Vector3d y_direction;  ///< along growing rows
  Eigen::Vector3d position;     ///< of the first voxel's centre [mm]
  Eigen::Vector3i decimals;     ///< that the position is written with
  double slope = 1.0, intercept = 0.0;
  bool has_rescale = false;
  std::string frame_of_reference;
  std::vector<std::string> traits;  ///< in the order of kTraits; the last one is the orientation in words
};

/// Slices of one SeriesInstanceUID that make up one volume, or of which it is known why not.
struct Stack
{
  std::string label;  ///< by which it is chosen
  std::vector<Slice> slices;
  VolumeGrid grid;
  std::string fault;  ///< empty: usable
};

/// What was found beside CT slices.
struct PassedOver
{
  std::map<std::string, int> counts;  ///< by kind

  std::string text() const
  {
    std::string list;
    for (const auto& [kind, count] : counts)
    {
      list += (list.empty() ? "" : ", ") + std::to_string(count) + " " + kind;
    }
    return list;
  }
};

std::string join(const std::vector<double>& values)
{
  std::ostringstream text;
  for (std::size_t n = 0; n < values.size(); ++n)
  {
    text << (n == 0 ? "" : "\\") << values[n];
  }
  return text.str();
}

std::string nameOf(const Slice& slice)
{
  return std::filesystem::path(slice.file).filename().string() +
         (slice.frame > 0 ? " frame " + std::to_string(slice.frame + 1) : "");
}

/// An attribute of a frame: of its own functional group, of the shared one, or of the file.
class FrameData
{
public:
  FrameData(const DicomData& file, const std::vector<DicomData>& shared, const std::vector<DicomData>& own)
  {
    for (const std::vector<DicomData>* groups : { &own, &shared })
    {
      for (const DicomData& group : *groups)
      {
        for (const gdcm::Tag& tag : { kPlanePosition, kPlaneOrientation, kPixelMeasures, kPixelValueTransformation,
                                      kFrameContent, kCtFrameType })
        {
          const std::vector<DicomData> items = group.items(tag);
          levels_.insert(levels_.end(), items.begin(), items.end());
        }
      }
    }
    levels_.push_back(file);
  }

  const DicomData& at(const gdcm::Tag& tag) const
  {
    const auto has = [&](const DicomData& level) { return level.has(tag); };
    const auto level = std::find_if(levels_.begin(), levels_.end(), has);
    return level != levels_.end() ? *level : levels_.back();
  }
  std::string text(const gdcm::Tag& tag) const { return at(tag).text(tag); }
  std::optional<double> number(const gdcm::Tag& tag) const { return at(tag).number(tag); }

  template <int SIZE>
  Eigen::Matrix<double, SIZE, 1> vector(const gdcm::Tag& tag, const char* name, const std::string& file) const
  {
    const std::vector<double> values = at(tag).numbers(tag);
    Eigen::Matrix<double, SIZE, 1> result;
    if (values.size() == SIZE)
    {
      result = Eigen::Map<const Eigen::Matrix<double, SIZE, 1>>(values.data());
    }
    if (values.size() != SIZE || !result.allFinite())
    {
      failCt(file, std::string(name) + " is \"" + (values.empty() ? text(tag) : join(values)) + "\", expected " +
                       std::to_string(SIZE) + " numbers");
    }
    return result;
  }

private:
  std::vector<DicomData> levels_;
};

/// Digits after the point of the three numbers of a DS attribute.
Eigen::Vector3i decimalsOf(const std::string& text)
{
  Eigen::Vector3i decimals = Eigen::Vector3i::Zero();
  std::istringstream fields(text);
  std::string field;
  for (int axis = 0; axis < 3 && std::getline(fields, field, '\\'); ++axis)
  {
    const std::size_t point = field.find('.');
    if (field.find_first_of("eE") != std::string::npos)
    {
      decimals[axis] = 9;
    }
    else if (point != std::string::npos)
    {
      decimals[axis] = static_cast<int>(field.find_last_of(".0123456789") - point);
    }
  }
  return decimals;
}

std::string orientationWord(const Slice& slice)
{
  const Eigen::Vector3d normal = slice.x_direction.cross(slice.y_direction).cwiseAbs();
  Eigen::Index axis = 0;
  if (normal.maxCoeff(&axis) < 0.9)
  {
    std::ostringstream text;
    const Eigen::Vector3d signed_normal = slice.x_direction.cross(slice.y_direction);
    text.precision(2);
    text << "oblique " << std::fixed << signed_normal.x() << " " << signed_normal.y() << " " << signed_normal.z();
    return text.str();
  }
  return std::array<const char*, 3>{ "sagittal", "coronal", "axial" }[static_cast<std::size_t>(axis)];
}

void readRescale(const FrameData& data, Slice& slice)
{
  if (data.at(kModalityLut).has(kModalityLut))
  {
    failCt(slice.file, "has a ModalityLUTSequence, expected RescaleSlope and RescaleIntercept to Hounsfield units");
  }
  const std::string type = data.text(kRescaleType);
  if (!type.empty() && type != "HU" && type != "US" && type != "HU_MOD")
  {
    failCt(slice.file, "RescaleType is " + type + ", expected HU");
  }
  // Only what is not there at all has a default.
  const auto read = [&data](const auto& tag, double absent)
  { return data.at(tag).has(tag) ? data.number(tag).value_or(NAN) : absent; };
  slice.slope = read(kSlope, 1.0);
  slice.intercept = read(kIntercept, 0.0);
  slice.has_rescale = data.at(kSlope).has(kSlope) || data.at(kIntercept).has(kIntercept);
  if (slice.slope == 0.0 || !std::isfinite(slice.slope) || !std::isfinite(slice.intercept))
  {
    failCt(slice.file, "RescaleSlope is \"" + data.text(kSlope) + "\", RescaleIntercept \"" + data.text(kIntercept) +
                           "\", expected finite numbers, and a slope that is not 0");
  }
}

Slice readSlice(const FrameData& data, const std::string& file, int frame)
{
  Slice slice;
  slice.file = file;
  slice.frame = frame;
  const Eigen::Vector2d size(data.vector<1>(kColumns, "Columns", file)[0], data.vector<1>(kRows, "Rows", file)[0]);
  if (!(size.minCoeff() >= 1.0 && size.maxCoeff() <= 65535.0))
  {
    std::ostringstream message;
    message << "Columns and Rows are " << size.x() << " and " << size.y() << ", expected 1 to 65535";
    failCt(file, message.str());
  }
  slice.size = size.cast<int>();
  slice.spacing = data.vector<2>(kPixelSpacing, "PixelSpacing", file).reverse();
  // Negated so that NaN fails, too.
  if (!(slice.spacing.minCoeff() >= kLeastSpacing && slice.spacing.maxCoeff() <= kMostSpacing))
  {
    failCt(file, "PixelSpacing is " + data.text(kPixelSpacing) + ", expected mm between pixels, 0.01 to 20");
  }
  slice.position = data.vector<3>(kPosition, "ImagePositionPatient", file);
  slice.decimals = decimalsOf(data.text(kPosition));
  const auto orientation = data.vector<6>(kOrientation, "ImageOrientationPatient", file);
  slice.x_direction = orientation.head<3>();
  slice.y_direction = orientation.tail<3>();
  if (std::abs(slice.x_direction.norm() - 1.0) > kDirectionTolerance ||
      std::abs(slice.y_direction.norm() - 1.0) > kDirectionTolerance ||
      std::abs(slice.x_direction.dot(slice.y_direction)) > kDirectionTolerance)
  {
    failCt(file,
           "ImageOrientationPatient is " + data.text(kOrientation) + ", expected two unit vectors at right angles");
  }
  slice.x_direction.normalize();
  slice.y_direction.normalize();
  const std::string anatomy = data.text(kAnatomicalOrientationType);
  if (!anatomy.empty() && anatomy != "BIPED")
  {
    failCt(file, "AnatomicalOrientationType is " + anatomy + ", expected BIPED");
  }
  readRescale(data, slice);
  slice.frame_of_reference = data.text(kFrameOfReference);
  for (const auto& [name, tag] : kTraits)
  {
    slice.traits.push_back(data.text(tag));
  }
  slice.traits.push_back(orientationWord(slice));
  return slice;
}

/// Adds the slices of a file; what is no slice of a volume is counted.
void addSlices(const DicomData& header, const std::string& file, std::map<std::string, std::vector<Slice>>& series,
               PassedOver& others)
{
  const std::string modality = header.text(kModality);
  if (modality != "CT")
  {
    ++others.counts[modality.empty() ? "without a modality" : modality];
    return;
  }
  const std::vector<DicomData> shared = header.items(kSharedGroups);
  const std::vector<DicomData> per_frame = header.items(kPerFrameGroups);
  const double claimed = header.number(kFrames).value_or(1.0);
  if (!(claimed <= kMostFrames))
  {
    failCt(file,
           "NumberOfFrames is " + header.text(kFrames) + ", expected " + std::to_string(kMostFrames) + " at most");
  }
  const int frames = static_cast<int>(std::max(claimed, 1.0));
  for (int frame = 0; frame < frames; ++frame)
  {
    const auto own = static_cast<std::size_t>(frame) < per_frame.size()
                         ? std::vector<DicomData>{ per_frame[static_cast<std::size_t>(frame)] }
                         : std::vector<DicomData>{};
    const FrameData data(header, shared, own);
    const std::string type = data.text(kImageType) + "\\" + data.text(kFrameType);
    const auto has_type = [&](const char* value) { return type.find(value) != std::string::npos; };
    if (has_type("LOCALIZER"))
    {
      ++others.counts["CT localizer (scout)"];
      continue;
    }
    const bool is_captured = data.text(kSopClass).compare(0, 25, "1.2.840.10008.5.1.4.1.1.7") == 0;
    const bool has_place = data.at(kPosition).has(kPosition) && data.at(kOrientation).has(kOrientation);
    if (header.number(kSamplesPerPixel).value_or(1.0) > 1.0 ||
        (!has_place && (is_captured || has_type("SECONDARY") || frames > 1)))
    {
      ++others.counts["CT screenshot or other image without a place"];
      continue;
    }
    series[header.text(kSeriesUid)].push_back(readSlice(data, file, frame));
  }
}

std::string whyNotSame(const std::vector<Slice>& slices)
{
  const Slice& first = slices.front();
  for (const Slice& slice : slices)
  {
    std::ostringstream message;
    if (slice.size != first.size)
    {
      message << "size is " << slice.size.x() << " x " << slice.size.y() << ", expected " << first.size.x() << " x "
              << first.size.y();
    }
    else if (!slice.spacing.isApprox(first.spacing, kDirectionTolerance))
    {
      message << "pixel spacing is " << slice.spacing.transpose() << " mm, expected " << first.spacing.transpose();
    }
    else if ((slice.x_direction - first.x_direction).norm() > kDirectionTolerance ||
             (slice.y_direction - first.y_direction).norm() > kDirectionTolerance)
    {
      message << "orientation is " << slice.x_direction.transpose() << ", " << slice.y_direction.transpose()
              << ", expected " << first.x_direction.transpose() << ", " << first.y_direction.transpose();
    }
    else if (slice.has_rescale != first.has_rescale)
    {
      message << (slice.has_rescale ? "has RescaleSlope or RescaleIntercept"
                                    : "has no RescaleSlope and RescaleIntercept")
              << ", expected the same";
    }
    if (!message.str().empty())
    {
      return nameOf(slice) + ": " + message.str() + " as in " + nameOf(first);
    }
  }
  return "";
}

/// @param slices sorted along the normal. @param first, step out, of the straight line of even steps that fits best
std::string whyNotEven(const std::vector<Slice>& slices, const Eigen::Vector3d& normal, Eigen::Vector3d& first,
                       Eigen::Vector3d& step)
{
  std::vector<double> distances;
  Eigen::Vector3i decimals = slices.front().decimals;
  for (std::size_t n = 1; n < slices.size(); ++n)
  {
    distances.push_back(normal.dot(slices[n].position - slices[n - 1].position));
    decimals = decimals.cwiseMax(slices[n].decimals);
  }
  std::vector<double> sorted = distances;
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  const double usual = sorted[sorted.size() / 2];
  // By half of a last digit at most; positions that need no digit are written without, so the slice with most counts.
  const Eigen::Vector3d half_digit = 0.5 * Eigen::pow(10.0, -decimals.cast<double>().array());
  const double rounding = std::min(half_digit.norm(), kMostRounding * usual);
  const double along = std::min(normal.cwiseAbs().dot(half_digit), kMostRounding * usual);
  for (std::size_t n = 0; n < distances.size(); ++n)
  {
    // Both ends are rounded, and those of the usual distance.
    if (std::abs(distances[n] - usual) <= kPlaceTolerance * usual + 2.0 * along && distances[n] > 0.3 * usual &&
        usual > 0.0)
    {
      continue;
    }
    const Slice& before = slices[n];
    const Slice& after = slices[n + 1];
    std::ostringstream message;
    message << (distances[n] > 1.5 * usual    ? "a slice is missing"
                : distances[n] <= 0.3 * usual ? "two slices at one place, not evenly spaced,"
                                              : "slices are not evenly spaced")
            << " between " << nameOf(before) << " at " << before.position.transpose() << " mm and " << nameOf(after)
            << " at " << after.position.transpose() << " mm: " << distances[n] << " mm apart, expected " << usual;
    return message.str();
  }

  // Least squares of position over slice number: rounded positions average out.
  const double count = static_cast<double>(slices.size());
  const double middle = 0.5 * (count - 1.0);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  step.setZero();
  for (std::size_t n = 0; n < slices.size(); ++n)
  {
    mean += slices[n].position / count;
    step += (static_cast<double>(n) - middle) * slices[n].position;
  }
  step *= 12.0 / (count * (count * count - 1.0));
  first = mean - middle * step;
  for (std::size_t n = 0; n < slices.size(); ++n)
  {
    const Eigen::Vector3d expected = first + static_cast<double>(n) * step;
    if ((slices[n].position - expected).norm() > 2.0 * kPlaceTolerance * usual + rounding)
    {
      std::ostringstream message;
      message << nameOf(slices[n]) << " is at " << slices[n].position.transpose()
              << " mm, expected on the line of the other slices at " << expected.transpose();
      return message.str();
    }
  }
  return "";
}

/// Puts the slices in order, and finds the grid or what is wrong.
Stack makeStack(std::string label, std::vector<Slice> slices)
{
  Stack stack{ std::move(label), std::move(slices), {}, "" };
  const Slice& any = stack.slices.front();
  const Eigen::Vector3d normal = any.x_direction.cross(any.y_direction).normalized();
  // By name where the place is the same: the same message every time.
  std::sort(stack.slices.begin(), stack.slices.end(),
            [&](const Slice& a, const Slice& b)
            {
              const double at_a = normal.dot(a.position), at_b = normal.dot(b.position);
              return at_a != at_b ? at_a < at_b : std::tie(a.file, a.frame) < std::tie(b.file, b.frame);
            });
  if (stack.slices.size() < 2)
  {
    stack.fault = "only one CT slice, expected a series";
    return stack;
  }
  Eigen::Vector3d first = Eigen::Vector3d::Zero();
  Eigen::Vector3d step = Eigen::Vector3d::Zero();
  stack.fault = whyNotSame(stack.slices);
  if (stack.fault.empty())
  {
    stack.fault = whyNotEven(stack.slices, normal, first, step);
  }
  if (stack.fault.empty())
  {
    const Slice& slice = stack.slices.front();
    stack.grid.size = { slice.size.x(), slice.size.y(), static_cast<int>(stack.slices.size()) };
    stack.grid.patient_from_index.linear() << slice.spacing.x() * slice.x_direction,
        slice.spacing.y() * slice.y_direction, step;
    stack.grid.patient_from_index.translation() = first;
  }
  return stack;
}

/// The volumes of one series: one, or several that one attribute tells apart.
std::vector<Stack> stacksOf(const std::string& uid, const std::vector<Slice>& slices)
{
  Stack whole = makeStack(uid, slices);
  if (whole.fault.empty())
  {
    return { whole };
  }
  for (std::size_t trait = 0; trait <= kTraits.size(); ++trait)
  {
    std::map<std::string, std::vector<Slice>> parts;
    for (const Slice& slice : slices)
    {
      parts[slice.traits[trait]].push_back(slice);
    }
    // Scanners of four rows number every turn; a gap between turns is no gap between volumes.
    if (parts.size() < 2 || kFewSlices * parts.size() >= slices.size())
    {
      continue;
    }
    const std::string name = trait < kTraits.size() ? kTraits[trait].first : "orientation";
    std::vector<Stack> stacks;
    for (const auto& [value, part] : parts)
    {
      const std::string shown = kNumbered.count(name) > 0 ? "#" + std::to_string(stacks.size() + 1) : value;
      stacks.push_back(makeStack(uid + " " + name + "=" + shown, part));
    }
    if (std::all_of(stacks.begin(), stacks.end(), [](const Stack& stack) { return stack.fault.empty(); }))
    {
      return stacks;
    }
  }
  return { whole };
}

std::string listOf(const std::vector<Stack>& stacks, const PassedOver& others)
{
  std::ostringstream list;
  for (const Stack& stack : stacks)
  {
    const Slice& first = stack.slices.front();
    list << "\n  ct_series: '" << withShortUids(stack.label) << "'  # " << stack.slices.size() << " slices, "
         << first.traits.back() << ", ";
    if (stack.fault.empty())
    {
      const Eigen::Vector3d spacing = stack.grid.spacing();
      list << spacing.x() << " x " << spacing.y() << " x " << spacing.z() << " mm";
    }
    else
    {
      list << "not usable: " << stack.fault;
    }
    list << ", acquisition " << (first.traits.front().empty() ? "not numbered" : first.traits.front()) << ", e.g. "
         << nameOf(first);
  }
  if (!others.counts.empty())
  {
    list << "\n  passed over: " << others.text();
  }
  return list.str();
}

std::size_t placesOf(const Stack& stack)
{
  std::set<std::array<double, 3>> places;
  for (const Slice& slice : stack.slices)
  {
    places.insert({ slice.position.x(), slice.position.y(), slice.position.z() });
  }
  return places.size();
}

Stack chosen(std::vector<Stack> stacks, const std::string& series, const PassedOver& others, const std::string& path)
{
  if (stacks.empty())
  {
    failCt(path, "no DICOM CT image in this folder" + (others.counts.empty() ? "" : "; found: " + others.text()));
  }
  // In full, or as the list has it.
  const auto isNamed = [&](const Stack& stack)
  {
    const std::string listed = withShortUids(stack.label);
    return stack.label == series || listed == series || stack.label.compare(0, series.size() + 1, series + " ") == 0 ||
           listed.compare(0, series.size() + 1, series + " ") == 0;
  };
  std::vector<Stack> candidates;
  if (!series.empty())
  {
    std::copy_if(stacks.begin(), stacks.end(), std::back_inserter(candidates), isNamed);
    if (candidates.empty())
    {
      failCt(path, "no series " + series + " here, expected one of" + listOf(stacks, others));
    }
  }
  else
  {
    std::size_t most = 0;
    for (const Stack& stack : stacks)
    {
      most = std::max(most, placesOf(stack));
    }
    const std::size_t least = most >= kFewSlices ? kFewSlices : 1;
    std::copy_if(stacks.begin(), stacks.end(), std::back_inserter(candidates),
                 [&](const Stack& stack) { return placesOf(stack) >= least; });
  }
  if (candidates.size() > 1)
  {
    failCt(path, std::to_string(candidates.size()) +
                     " CT series or volumes here, expected one, or the setup's ct_series (--series) to choose:" +
                     listOf(candidates, others));
  }
  return std::move(candidates.front());
}

/// The name without its numbers, and its extension.
std::string patternOf(const std::filesystem::path& file)
{
  std::string pattern;
  for (const char character : file.filename().string())
  {
    const bool digit = character >= '0' && character <= '9';
    if (!digit || pattern.empty() || pattern.back() != '#')
    {
      pattern += digit ? '#' : character;
    }
  }
  return pattern;
}

/// An empty or cut-off slice at the end of a series would leave no gap that tells of it.
/// @throws if a file beside the slices is named like them and is not DICOM
void requireReadable(const std::vector<std::filesystem::path>& unreadable, const Stack& stack, const std::string& path)
{
  std::set<std::string> named;
  for (const Slice& slice : stack.slices)
  {
    const std::filesystem::path file(slice.file);
    const std::string folder = file.parent_path().string() + "/";
    named.insert(folder + patternOf(file));
    if (file.has_extension() && file.extension().string().find_first_not_of(".0123456789") != std::string::npos)
    {
      named.insert(folder + "*" + file.extension().string());
    }
  }
  for (const std::filesystem::path& file : unreadable)
  {
    const std::string folder = file.parent_path().string() + "/";
    if (named.count(folder + patternOf(file)) + named.count(folder + "*" + file.extension().string()) > 0)
    {
      failCt(path,
             file.filename().string() + " is not a readable DICOM file, but is named like the slices of the series");
    }
  }
}

StoredVolume readPixels(const Stack& stack, const std::string& path)
{
  requireUsableGrid(stack.grid, path);
  StoredVolume stored;
  stored.volume.grid = stack.grid;
  stored.volume.hu.reserve(stack.grid.voxelCount());
  std::unique_ptr<DicomPixels> pixels;
  std::string open;
  std::vector<std::int32_t> values;
  std::vector<float> scaled(static_cast<std::size_t>(stack.grid.size.x()) * stack.grid.size.y());
  for (const Slice& slice : stack.slices)
  {
    try
    {
      if (open != slice.file)
      {
        pixels.reset();
        pixels = std::make_unique<DicomPixels>(slice.file);
        open = slice.file;
      }
    }
    catch (const std::runtime_error& error)
    {
      throw std::runtime_error(std::string("CT ") + error.what());
    }
    if (slice.frame >= pixels->frames() || pixels->columns() != slice.size.x() || pixels->rows() != slice.size.y())
    {
      failCt(slice.file, "has changed while it was read");
    }
    pixels->read(slice.frame, values);
    const std::optional<std::int32_t> padding = pixels->value(kPixelPadding);
    const std::int32_t one = padding.value_or(0);
    const std::int32_t other = pixels->value(kPixelPaddingLimit).value_or(one);
    const auto isPadding = [&](std::int32_t value)
    { return padding && value >= std::min(one, other) && value <= std::max(one, other); };
    for (std::size_t n = 0; n < values.size(); ++n)
    {
      // What was not scanned shows nothing of the patient: air.
      scaled[n] = isPadding(values[n]) ? -1000.0f : static_cast<float>(slice.slope * values[n] + slice.intercept);
    }
    appendRounded(scaled.data(), scaled.size(), slice.file, stored);
  }
  return stored;
}

/// The volume to be read, by the headers of all files.
Stack findStack(const std::string& path, const std::string& series)
{
  namespace fs = std::filesystem;
  std::vector<fs::path> files{ path };
  if (fs::is_directory(path))
  {
    files.clear();
    for (const auto& entry : fs::recursive_directory_iterator(path))
    {
      if (entry.is_regular_file())
      {
        files.push_back(entry.path());
      }
    }
    std::sort(files.begin(), files.end());
  }
  std::map<std::string, std::vector<Slice>> slices;
  std::vector<fs::path> unreadable;
  PassedOver others;
  for (const fs::path& file : files)
  {
    const std::optional<DicomHeader> header = readDicomHeader(file.string());
    if (!header || !header->data.has(kSopClass))
    {
      unreadable.push_back(file);
    }
    else if (header->fault.empty() || header->data.text(kModality) != "CT")
    {
      addSlices(header->data, file.string(), slices, others);
    }
    else
    {
      failCt(file.string(), header->fault);
    }
  }
  std::vector<Stack> stacks;
  for (const auto& [uid, of_series] : slices)
  {
    for (Stack& stack : stacksOf(uid, of_series))
    {
      stacks.push_back(std::move(stack));
    }
  }
  Stack stack = chosen(std::move(stacks), series, others, path);
  requireReadable(unreadable, stack, path);
  if (!stack.fault.empty())
  {
    failCt(path, stack.fault);
  }
  return stack;
}
}  // namespace

StoredVolume readDicomCt(const std::string& path, const std::string& series)
{
  return readPixels(findStack(path, series), path);
}

CtFrame readCtFrame(const std::string& path, const std::string& series)
{
  namespace fs = std::filesystem;
  try
  {
    if (!fs::is_directory(path) && (!fs::is_regular_file(path) || !readDicomHeader(path)))
    {
      failCt(path, fs::exists(path) ? "no DICOM, so that its frame of reference is unknown; expected the DICOM series "
                                      "that the plan's structures were drawn on, or target_box_mm instead of target"
                                    : "no such file or folder");
    }
    const Stack stack = findStack(path, series);
    CtFrame frame{ path, stack.grid, stack.slices.front().frame_of_reference };
    for (const Slice& slice : stack.slices)
    {
      if (slice.frame_of_reference.empty() || slice.frame_of_reference != frame.frame_of_reference)
      {
        failCt(path, nameOf(slice) + ": FrameOfReferenceUID (0020,0052) is " +
                         (slice.frame_of_reference.empty() ? "absent" : slice.frame_of_reference) + ", expected " +
                         (frame.frame_of_reference.empty() ? "one" : frame.frame_of_reference) +
                         ", the same of all slices");
      }
    }
    return frame;
  }
  catch (const fs::filesystem_error& error)
  {
    failCt(path, "cannot be read: " + error.code().message());
  }
}
}  // namespace xray_tracking
